// A folder of a test's own below the system's temporary one, and a file in one that is written again and
// again.
#pragma once

#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>

namespace brickyard {

class StoredFolder {
public:
    StoredFolder() {
        static std::atomic<int> count{0};
        path_ = std::filesystem::temp_directory_path() /
                ("brickyard-stored-" + std::to_string(::getpid()) + "-" + std::to_string(count++));
        std::filesystem::create_directories(path_);
    }
    ~StoredFolder() {
        std::error_code ignored;
        std::filesystem::remove_all(path_, ignored);
    }
    StoredFolder(const StoredFolder&) = delete;
    StoredFolder& operator=(const StoredFolder&) = delete;
    const std::filesystem::path& path() const { return path_; }

private:
    std::filesystem::path path_;
};

class StoredFile {
public:
    explicit StoredFile(const std::string& name) : path_(folder_.path() / name) {}
    void write(std::string_view text) const {
        std::ofstream out(path_, std::ios::binary | std::ios::trunc);
        out << text;
    }
    const std::filesystem::path& path() const { return path_; }

private:
    StoredFolder folder_;
    std::filesystem::path path_;
};

}  // namespace brickyard
