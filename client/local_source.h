// A dataset folder as a source of pages. What it reads counts as streamed, so that its figures compare with a
// server's.
#pragma once

#include <filesystem>
#include <memory>
#include <mutex>
#include <optional>

#include "client/brick_source.h"
#include "core/dataset.h"
#include "core/frame_reader.h"
#include "core/wish_walk.h"

namespace brickyard {

class LocalSource : public BrickSource {
public:
    // Errors: those of Dataset::open.
    static Result<std::unique_ptr<LocalSource>> open(const std::filesystem::path& folder);

    std::string name() const override { return dataset_.folder().string(); }
    const Manifest& manifest() const override { return *first_manifest_; }
    std::shared_ptr<const Manifest> latestManifest() const override;
    // Looks at the folder again and again.
    Result<bool> waitForChange(SourceDeadline deadline) override;
    // Never waits for anything but the disk.
    Result<FrameFooter> openFrame(std::uint32_t frame,
                                  SourceDeadline deadline = SourceDeadline::max()) override;
    Result<void> wish(PageWish newest) override;
    // Reads the pages now; never waits for anything but the disk.
    Result<std::vector<Arrival>> take(SourceDeadline deadline) override;
    bool wishDone() const override { return !walk_; }
    SourceCounters counters() const override { return counters_; }

private:
    explicit LocalSource(Dataset dataset);

    // Reads the manifest again where it is another file now. True where it says something else.
    Result<bool> refresh();

    Dataset dataset_;
    std::filesystem::file_time_type modified_;  // of the manifest that dataset_ has read
    std::shared_ptr<const Manifest> first_manifest_;
    mutable std::mutex mutex_;  // guards the next
    std::shared_ptr<const Manifest> manifest_;
    std::shared_ptr<BlockCache> blocks_;
    std::shared_ptr<const FrameReader> frame_;
    std::uint32_t frame_number_ = 0;  // of frame_
    bool stale_ = false;              // the manifest changed since: the frame may be another one
    std::optional<WishWalk> walk_;    // what is left of the newest wish
    SourceCounters counters_;
};

}  // namespace brickyard
