// The bytes of one .vdb file: reads at a place, and reads forward from one. Nothing is read beyond the size
// that the file had when it was opened.
#pragma once

#include <sys/stat.h>

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <optional>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "core/result.h"

namespace brickyard {

// An open file. Any thread may call any const member.
class VdbBytes {
public:
    // Errors: kNotFound, kIo, kInvalid (a folder or a device).
    static Result<VdbBytes> open(const std::filesystem::path& file);
    VdbBytes(VdbBytes&& other) noexcept;
    VdbBytes& operator=(VdbBytes&&) = delete;
    ~VdbBytes();

    std::uint64_t size() const { return std::uint64_t(status_.st_size); }
    const std::string& path() const { return path_; }

    // REQUIRES: begin + out.size() <= size(). Errors: kIo.
    Result<void> readAt(std::uint64_t begin, std::span<std::byte> out) const;
    // Errors: kIo where size or time of the last change are no longer those at open(): a program still writes
    // it.
    Result<void> checkUnchanged() const;

private:
    VdbBytes(int file, const struct stat& status, std::string path)
        : file_(file), status_(status), path_(std::move(path)) {}
    tl::unexpected<Error> changed() const;

    int file_;
    struct stat status_;
    std::string path_;
};

// Reads [begin, end) forward, in large pieces. A read that would leave that range fails, and so does every
// later one. One thread.
class VdbCursor {
public:
    // One read of this size costs about as much as the call itself, from the page cache too.
    static constexpr std::size_t kLongRun = 256u << 10;

    // Reads ahead by `piece_bytes`. REQUIRES: begin <= end <= file.size(); `file` lives longer.
    VdbCursor(const VdbBytes& file, std::uint64_t begin, std::uint64_t end, std::size_t piece_bytes)
        : file_(&file), position_(begin), end_(end), piece_bytes_(piece_bytes), buffer_at_(begin) {}

    std::uint64_t position() const { return position_; }
    std::uint64_t left() const { return end_ - position_; }
    // False once anything was not there. Then error() has the system's reason, if it was the system.
    bool ok() const { return ok_; }
    const std::optional<Error>& error() const { return error_; }

    // The next bytes without passing them: `count` of them, fewer before the end. Valid until the next call.
    std::span<const std::byte> peek(std::size_t count);
    // Exactly `count` bytes, passed; empty where they are not there. Valid until the next call.
    std::span<const std::byte> take(std::size_t count);
    void skip(std::uint64_t count);

    template <class T>
    T number() {
        static_assert(std::is_trivially_copyable_v<T>);
        T value{};
        if (const auto bytes = take(sizeof(T)); !bytes.empty()) std::memcpy(&value, bytes.data(), sizeof(T));
        return value;
    }
    // A length of 32 bits and as many characters, at most `most`.
    std::string string(std::uint32_t most);

private:
    bool fill(std::size_t count);

    const VdbBytes* file_;
    std::uint64_t position_, end_;
    std::size_t piece_bytes_;
    // Invariant: buffer_[0, buffered_) holds the file's bytes from buffer_at_, and
    // buffer_at_ <= position_ wherever anything is buffered.
    std::uint64_t buffer_at_;
    std::size_t buffered_ = 0;
    std::vector<std::byte> buffer_;
    bool ok_ = true;
    std::optional<Error> error_;
};

}  // namespace brickyard
