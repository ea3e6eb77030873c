// A dataset folder, open for reading: the manifest and, on demand, its frames. Any thread.
#pragma once

#include <filesystem>
#include <memory>

#include "core/brick_store.h"
#include "core/result.h"
#include "proto/dataset.pb.h"

namespace brickyard {

inline constexpr std::uint32_t kFormatMajor = 1;
inline constexpr std::uint32_t kFormatMinor = 0;
inline constexpr const char* kManifestName = "manifest.json";

// Checks version, brick edge, order of frames, and that no frame's file name leaves the folder.
// Errors: kTooNew; kCorrupt. `where` is the path that messages name.
Result<Manifest> parseManifest(const std::string& json, const std::string& where);
std::string printManifest(const Manifest& manifest);

class Dataset {
public:
    // Reads the manifest; no frame is touched. Errors: kNotFound (no folder, or none of ours), kTooNew,
    // kCorrupt, kIo.
    static Result<Dataset> open(const std::filesystem::path& folder);

    const std::filesystem::path& folder() const { return folder_; }
    const Manifest& manifest() const { return manifest_; }
    // The entry of a frame number, or nullptr.
    const FrameEntry* findFrame(std::uint32_t frame) const;
    // Errors: kNotFound (no such frame; says which there are), kCorrupt (the file is not the one the manifest
    // means), and those of BrickStore::open.
    Result<std::shared_ptr<const BrickStore>> openFrame(std::uint32_t frame) const;

private:
    std::filesystem::path folder_;
    Manifest manifest_;
};

// "0-29, 40": the frame numbers, for messages.
std::string describeFrames(const Manifest& manifest);

}  // namespace brickyard
