// The datasets that a server offers, by name, and their frames, opened on demand. Any thread.
#pragma once

#include <filesystem>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "core/dataset.h"
#include "core/frame_reader.h"
#include "core/result.h"

namespace brickyard {

class Catalog {
public:
    // A dataset's name is its folder's without ".bricks". Looks at the size of every frame file and opens the
    // first, so that a damaged dataset is noticed now. Errors: those of Dataset; kInvalid (two datasets of
    // one name).
    static Result<std::unique_ptr<Catalog>> open(const std::vector<std::filesystem::path>& folders,
                                                 std::size_t max_open_frames,
                                                 std::uint64_t block_cache_bytes);

    const std::vector<std::string>& names() const { return names_; }

    // As the manifest is on disk now: frames may be appended while they are served. Errors: kNotFound (says
    // which datasets there are).
    Result<std::shared_ptr<const Dataset>> dataset(const std::string& name) const;

    // Errors: kNotFound (no such dataset or frame), and those of BrickStore.
    Result<std::shared_ptr<const FrameReader>> frame(const std::string& name, std::uint32_t frame) const;

private:
    struct Stamp {
        std::filesystem::file_time_type modified;
        std::uintmax_t bytes = 0;
        bool operator==(const Stamp&) const = default;
    };
    struct Entry {
        std::filesystem::path folder;
        Stamp stamp;
        std::shared_ptr<const Dataset> dataset;
    };
    struct OpenFrame {
        std::string name;
        std::uint32_t frame = 0;
        std::uint64_t footer_checksum =
            0;  // of the manifest's entry: a frame that was replaced is another one
        std::shared_ptr<const FrameReader> reader;
    };

    Catalog(std::size_t max_open_frames, std::uint64_t block_cache_bytes);
    static Stamp stampOf(const std::filesystem::path& folder);

    const std::size_t max_open_frames_;
    std::vector<std::string> names_;
    std::shared_ptr<BlockCache> blocks_;
    mutable std::mutex mutex_;
    mutable std::map<std::string, Entry> entries_;
    mutable std::list<OpenFrame> frames_;  // most recently asked for first
};

}  // namespace brickyard
