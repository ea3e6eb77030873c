#include "core/folder_lock.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <ctime>

#include "core/io_error.h"

namespace brickyard {
namespace {

constexpr std::time_t kForeignSeconds = 24 * 60 * 60;

std::string hostName() {
    std::array<char, 256> name{};
    if (::gethostname(name.data(), name.size() - 1) != 0) return "unknown";
    std::string text = name.data();
    for (char& c : text)
        if (c == '/' || c == '@') c = '_';
    return text;
}

LockState lock(const Descriptor& descriptor, int how) {
    for (;;) {
        if (::flock(descriptor.get(), how) == 0) return LockState::kOurs;
        if (errno == EWOULDBLOCK) return LockState::kTaken;
        if (errno != EINTR) return LockState::kUnsupported;
    }
}

}  // namespace

Descriptor::~Descriptor() {
    if (value_ >= 0) ::close(value_);
}

LockState tryLock(const Descriptor& descriptor) { return lock(descriptor, LOCK_EX | LOCK_NB); }

bool stillNames(const std::filesystem::path& path, const Descriptor& descriptor) {
    struct stat opened{}, named{};
    return ::fstat(descriptor.get(), &opened) == 0 && ::lstat(path.c_str(), &named) == 0 &&
           opened.st_ino == named.st_ino && opened.st_dev == named.st_dev;
}

Result<Descriptor> lockFolder(const std::filesystem::path& folder) {
    for (;;) {
        Descriptor descriptor(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
        if (!descriptor) return ioError("open", folder, errno);
        lock(descriptor, LOCK_EX);
        if (stillNames(folder, descriptor)) return descriptor;
    }
}

std::string ownerSuffix() {
    static std::atomic<unsigned> count{0};
    return fmt::format("{}-{}@{}", ::getpid(), count++, hostName());
}

bool isAbandoned(const std::filesystem::path& path) {
    const std::string name = path.filename();
    const std::size_t at = name.rfind('@');
    const bool foreign = at != std::string::npos && name.substr(at + 1) != hostName();
    const Descriptor descriptor(::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW));
    if (!descriptor) return false;
    const LockState state = tryLock(descriptor);
    if (state == LockState::kOurs && !foreign) return true;
    struct stat status{};
    return state != LockState::kTaken && ::fstat(descriptor.get(), &status) == 0 &&
           std::time(nullptr) - status.st_mtime > kForeignSeconds;
}

}  // namespace brickyard
