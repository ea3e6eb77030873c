// Adds frames to a dataset folder so that a kill at any moment leaves the old state or the new: a frame is
// written under a temporary name, synced, named, and only then entered into the manifest by an atomic
// replace. Processes on any number of machines may add frames to one folder (manifest_commit.h); nothing is
// locked while a frame is made. Temporary files carry a lock while their writer lives and the name of their
// machine; abandoned ones (folder_lock.h) are removed at open.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>

#include "core/result.h"
#include "proto/dataset.pb.h"

namespace brickyard {

enum class ExistingDataset {
    kContinue,   // add the frames that are missing; refuse settings or sources that differ from the stored
                 // ones
    kAppend,     // as kContinue, and new frames are welcome
    kOverwrite,  // build aside, then exchange the folders: readers see the old dataset or the new one
};

class DatasetWriter {
public:
    // `settings` has everything of the manifest but frames. Creates the folder where there is none.
    // Errors: kInvalid (exists and is something else, or was made with other settings: says which and what to
    // do), kIo.
    static Result<std::unique_ptr<DatasetWriter>> open(const std::filesystem::path& folder,
                                                       const Manifest& settings, ExistingDataset existing);
    // Not committed: removes its temporary files and, where it created the folder and no frame was added, the
    // folder.
    ~DatasetWriter();

    // What is there now, frames included.
    const Manifest& manifest() const;
    // A fresh path in the same file system for FrameWriter; locked by this process.
    Result<std::filesystem::path> temporaryFrame(std::uint32_t frame);
    // The file at `temporary`, complete and synced, becomes frame `entry.frame`: fills in entry.file,
    // renames, syncs the folder, replaces the manifest. A frame of that number is replaced.
    Result<void> commitFrame(const std::filesystem::path& temporary, FrameEntry entry);
    // After the last frame; with kOverwrite this is where the new dataset takes the old one's place.
    Result<void> finish();

private:
    struct State;
    explicit DatasetWriter(std::unique_ptr<State> state);
    std::unique_ptr<State> state_;
};

}  // namespace brickyard
