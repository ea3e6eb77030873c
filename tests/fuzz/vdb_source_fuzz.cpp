// The input as a .vdb file: whatever it says, reading ends, in bounds and in bounded memory. Begin with sound
// files:
//   vdb_source_fuzz NEW_FOLDER tests/data/vdb_seeds
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

#include "read_everything.h"
#include "tools/importers/vdb_source.h"

using namespace brickyard;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static const int file = ::memfd_create("input.vdb", MFD_CLOEXEC);
    if (file < 0 || ::ftruncate(file, 0) != 0 || ::pwrite(file, data, size, 0) != ssize_t(size)) std::abort();
    const auto contents = openVdb("/proc/self/fd/" + std::to_string(file), {});
    if (!contents) return 0;
    for (const Error& error : readEverything(*contents, /*most_boxes=*/6, /*box_edge=*/16))
        if (error.message.find('\n') != std::string::npos) std::abort();
    return 0;
}
