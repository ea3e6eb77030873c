// Locks on files and folders by flock, and names of temporary files by their owner. A lock keeps the
// processes of one machine apart, and those of several where the file system passes locks on; where it does
// not, or has no locks, nothing here may be relied on for more than courtesy
// (docs/decisions/0006-farm-commits.md).
#pragma once

#include <filesystem>
#include <string>
#include <utility>

#include "core/result.h"

namespace brickyard {

// A file descriptor that closes itself; a lock held through it ends with it, or with the process.
class Descriptor {
public:
    Descriptor() = default;
    explicit Descriptor(int value) : value_(value) {}
    Descriptor(Descriptor&& other) noexcept : value_(std::exchange(other.value_, -1)) {}
    Descriptor& operator=(Descriptor&& other) noexcept {
        std::swap(value_, other.value_);
        return *this;
    }
    ~Descriptor();
    int get() const { return value_; }
    explicit operator bool() const { return value_ >= 0; }

private:
    int value_ = -1;
};

enum class LockState { kOurs, kTaken, kUnsupported };

// Without waiting.
LockState tryLock(const Descriptor& descriptor);
// Whether `path` still names what is open: between open and lock someone else may have replaced or removed
// it.
bool stillNames(const std::filesystem::path& path, const Descriptor& descriptor);
// Waits for the lock of a folder; open but not locked where the file system has no locks. Errors: kNotFound,
// kIo.
Result<Descriptor> lockFolder(const std::filesystem::path& folder);

// "PID-N@HOST", another one each time: the end of a temporary file's name, which tells whose it is.
std::string ownerSuffix();
// Whether the file or folder, whose name ends in an owner's suffix, has no living owner: nobody on this
// machine holds its lock, or it is another machine's and has not changed for a day. Says no where that is not
// known.
bool isAbandoned(const std::filesystem::path& path);

}  // namespace brickyard
