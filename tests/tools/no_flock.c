/* Stands before the C library in a process: a file system that knows no locks. */
#include <errno.h>

int flock(int descriptor, int operation);
int flock(int descriptor, int operation) {
    (void)descriptor;
    (void)operation;
    errno = ENOLCK;
    return -1;
}
