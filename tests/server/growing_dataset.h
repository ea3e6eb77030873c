// A dataset folder that changes under a server: frames of other datasets are put into it, as a conversion
// does it, manifest last and at once.
#pragma once

#include <filesystem>
#include <fstream>
#include <string>

#include "core/dataset.h"
#include "tiny_dataset.h"

namespace brickyard {

class GrowingDataset {
public:
    explicit GrowingDataset(const std::string& name, const TinyOptions& options = {})
        : first_(name, options) {}
    const std::filesystem::path& folder() const { return first_.folder(); }
    const TinyDataset& first() const { return first_; }

    // Becomes what `other` is, as if it had been converted again. Whoever has a frame open keeps it.
    void become(const TinyDataset& other) const {
        namespace fs = std::filesystem;
        const Manifest manifest = Dataset::open(other.folder())->manifest();
        for (const FrameEntry& frame : manifest.frames()) {
            fs::create_directories((folder() / frame.file()).parent_path());
            fs::copy_file(other.folder() / frame.file(), folder() / "new");
            fs::rename(folder() / "new", folder() / frame.file());
        }
        fs::copy_file(other.folder() / kManifestName, folder() / "new");
        fs::rename(folder() / "new", folder() / kManifestName);
    }
    void remove() const { std::filesystem::remove_all(folder()); }
    std::filesystem::path frameFile() const {
        return folder() / Dataset::open(folder())->manifest().frames(0).file();
    }

private:
    TinyDataset first_;
};

}  // namespace brickyard
