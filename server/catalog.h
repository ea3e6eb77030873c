// The datasets that a server offers, by name, and their frames, opened on demand. What is on disk may change
// meanwhile: frames are appended, datasets come and go. Any thread.
#pragma once

#include <chrono>
#include <filesystem>
#include <list>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "core/dataset.h"
#include "core/frame_reader.h"
#include "core/result.h"

namespace brickyard {

// A frame as it was when it was opened: whoever holds it reads the same bytes until it lets go, whatever
// happens to the folder.
struct ServedFrame {
    std::uint32_t number = 0;
    std::shared_ptr<const FrameReader> reader;
};

class Catalog {
public:
    // Each path is a dataset, or a folder of datasets ("*.bricks"), which may be empty for now. A dataset's
    // name is its folder's without ".bricks". Looks at the size of every frame file and opens the first, so
    // that a damaged dataset is noticed now. Errors: those of Dataset; kInvalid (two datasets of one name).
    static Result<std::unique_ptr<Catalog>> open(const std::vector<std::filesystem::path>& paths,
                                                 std::size_t max_open_frames,
                                                 std::uint64_t block_cache_bytes);

    // Rising.
    std::vector<std::string> names() const;

    // As the manifest is on disk now, or was at most kFresh ago. Reads from the disk. Errors: kNotFound (says
    // which datasets there are, of those that `allows` lets through).
    Result<std::shared_ptr<const Dataset>> dataset(const std::string& name) const;

    // `number` absent: the first there is. Reads from the disk. Errors: kNotFound (no such dataset or frame),
    // and those of BrickStore.
    Result<ServedFrame> frame(const std::string& name, std::optional<std::uint32_t> number) const;
    // The same without looking at the disk: nullptr where the frame is not open.
    std::shared_ptr<const FrameReader> openedFrame(const std::string& name, std::uint32_t number) const;

    struct Changes {
        bool names = false;                 // datasets came or went
        std::vector<std::string> datasets;  // whose manifest is another one, or that are gone
        std::vector<std::string> warnings;  // one line each: what is there but cannot be served
    };
    // Looks at the disk for what changed since the last time.
    Changes refresh();

    struct Counts {
        std::uint64_t block_cache_bytes = 0, block_cache_hits = 0, block_cache_misses = 0;
        std::uint64_t open_frames = 0, datasets = 0, frames = 0;
    };
    Counts counts() const;

private:
    struct Stamp {
        std::filesystem::file_time_type modified;
        std::uintmax_t bytes = 0;
        std::uint64_t inode = 0;
        bool operator==(const Stamp&) const = default;
    };
    struct Entry {
        std::filesystem::path folder;
        bool from_library = false;  // found in a folder of datasets, and forgotten when it is gone
        bool changed = false;       // since the last refresh(), whoever noticed it
        bool told = true;           // whether it was there at the last refresh()
        Stamp stamp;
        std::chrono::steady_clock::time_point looked;
        std::shared_ptr<const Dataset> dataset;  // nullptr while it is not there
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
    // Errors: those of Dataset, and what is wrong with its frame files.
    static Result<Entry> openEntry(const std::filesystem::path& folder);
    // REQUIRES: the mutex is held, for these.
    std::string describeNames() const;
    void look(Entry& entry) const;
    void addFromLibrary(const std::filesystem::path& library, Changes& changes);

    const std::size_t max_open_frames_;
    std::vector<std::filesystem::path> libraries_;
    std::shared_ptr<BlockCache> blocks_;
    mutable std::mutex mutex_;
    mutable std::map<std::string, Entry> entries_;
    mutable std::list<OpenFrame> frames_;              // most recently asked for first
    std::vector<std::string> early_warnings_;          // of opening; for the first refresh
    std::map<std::filesystem::path, Stamp> rejected_;  // told once, until they change
};

}  // namespace brickyard
