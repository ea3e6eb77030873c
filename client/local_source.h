// A dataset folder as a source of pages. What it reads counts as streamed, so that its figures compare with a
// server's.
#pragma once

#include <filesystem>
#include <memory>
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

    const Manifest& manifest() const override { return dataset_.manifest(); }
    Result<FrameFooter> openFrame(std::uint32_t frame) override;
    Result<void> wish(PageWish newest) override;
    // Reads the pages now; never waits for anything but the disk.
    Result<std::vector<Arrival>> take(std::chrono::steady_clock::time_point deadline) override;
    bool wishDone() const override { return !walk_; }
    SourceCounters counters() const override { return counters_; }

private:
    explicit LocalSource(Dataset dataset);

    Dataset dataset_;
    std::shared_ptr<BlockCache> blocks_;
    std::shared_ptr<const FrameReader> frame_;
    std::uint32_t frame_number_ = 0;  // of frame_
    std::optional<WishWalk> walk_;    // what is left of the newest wish
    SourceCounters counters_;
};

}  // namespace brickyard
