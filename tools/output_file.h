// A file that is written under a temporary name and takes its own when it is complete: whoever looks sees the
// old file or the new one. Not thread-safe.
#pragma once

#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <string>

#include "core/io_error.h"
#include "core/result.h"

namespace brickyard {

class OutputFile {
public:
    explicit OutputFile(std::filesystem::path file)
        : file_(std::move(file)), temporary_(file_.string() + ".tmp-" + std::to_string(::getpid())) {}
    OutputFile(const OutputFile&) = delete;
    OutputFile& operator=(const OutputFile&) = delete;
    // Not committed: nothing is left.
    ~OutputFile() {
        if (!committed_) ::unlink(temporary_.c_str());
    }

    const std::filesystem::path& file() const { return file_; }
    // Where to write.
    const std::filesystem::path& temporary() const { return temporary_; }
    // REQUIRES: what is to stand at file() is written to temporary() and closed.
    Result<void> commit() {
        if (::rename(temporary_.c_str(), file_.c_str()) != 0) return ioError("write", file_, errno);
        committed_ = true;
        return {};
    }

private:
    std::filesystem::path file_, temporary_;
    bool committed_ = false;
};

}  // namespace brickyard
