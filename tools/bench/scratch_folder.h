// A temporary folder that is gone when the command ends: done, failed, or interrupted.
#pragma once

#include <filesystem>
#include <memory>
#include <thread>

#include "core/result.h"

namespace brickyard {

class ScratchFolder {
public:
    // In TMPDIR or /tmp. While it lives SIGINT, SIGTERM and SIGHUP are blocked in this thread and in those
    // that it starts later; a thread of its own takes them, removes the folder and lets them end the program.
    // One at a time. Errors: kIo.
    static Result<std::unique_ptr<ScratchFolder>> create();
    ~ScratchFolder();
    ScratchFolder(const ScratchFolder&) = delete;
    ScratchFolder& operator=(const ScratchFolder&) = delete;

    const std::filesystem::path& path() const { return path_; }

private:
    explicit ScratchFolder(std::filesystem::path path);
    void remove() const;

    std::filesystem::path path_;
    std::jthread watch_;
};

}  // namespace brickyard
