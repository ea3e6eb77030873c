#include "client/local_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <thread>

namespace brickyard {
namespace {

constexpr std::uint64_t kBlockCacheBytes = 64u << 20;
// A chunk is what one take() gives: small enough that a deadline is kept, large enough that calls do not
// count.
constexpr std::size_t kChunkPages = 64;
constexpr std::size_t kChunkBytes = 1u << 20;
// How often waitForChange() looks.
constexpr std::chrono::milliseconds kLookEvery{50};

std::filesystem::file_time_type modifiedAt(const std::filesystem::path& folder) {
    std::error_code gone;
    const auto at = std::filesystem::last_write_time(folder / kManifestName, gone);
    return gone ? std::filesystem::file_time_type::min() : at;
}

}  // namespace

LocalSource::LocalSource(Dataset dataset)
    : dataset_(std::move(dataset)),
      modified_(modifiedAt(dataset_.folder())),
      first_manifest_(std::make_shared<const Manifest>(dataset_.manifest())),
      manifest_(first_manifest_),
      blocks_(std::make_shared<BlockCache>(kBlockCacheBytes)) {}

Result<std::unique_ptr<LocalSource>> LocalSource::open(const std::filesystem::path& folder) {
    auto dataset = Dataset::open(folder);
    if (!dataset) return tl::unexpected(dataset.error());
    std::unique_ptr<LocalSource> source(new LocalSource(std::move(*dataset)));
    ++source->counters_.round_trips;
    return source;
}

std::shared_ptr<const Manifest> LocalSource::latestManifest() const {
    const std::lock_guard lock(mutex_);
    return manifest_;
}

Result<bool> LocalSource::refresh() {
    const auto modified = modifiedAt(dataset_.folder());
    if (modified == modified_) return false;
    auto newest = Dataset::open(dataset_.folder());
    if (!newest) return tl::unexpected(newest.error());
    modified_ = modified;
    dataset_ = std::move(*newest);
    auto manifest = std::make_shared<const Manifest>(dataset_.manifest());
    const std::lock_guard lock(mutex_);
    const bool changed = manifest->SerializeAsString() != manifest_->SerializeAsString();
    manifest_ = std::move(manifest);
    stale_ = stale_ || changed;
    return changed;
}

Result<bool> LocalSource::waitForChange(SourceDeadline deadline) {
    for (;;) {
        const Result<bool> changed = refresh();
        if (!changed || *changed) return changed;
        const auto now = std::chrono::steady_clock::now();
        if (now >= deadline) return false;
        std::this_thread::sleep_for(
            std::min<std::chrono::steady_clock::duration>(kLookEvery, deadline - now));
    }
}

Result<FrameFooter> LocalSource::openFrame(std::uint32_t frame, SourceDeadline) {
    ++counters_.round_trips;
    // Once more for another picture: a new reader would have all of its blocks decoded and cached again.
    if (frame_ && frame_number_ == frame && !stale_) {
        walk_.reset();
        return frame_->footer();
    }
    auto store = dataset_.openFrame(frame);
    if (!store) return tl::unexpected(store.error());
    walk_.reset();
    stale_ = false;
    frame_number_ = frame;
    frame_ = std::make_shared<const FrameReader>(std::move(*store), blocks_);
    return frame_->footer();
}

Result<void> LocalSource::wish(PageWish newest) {
    if (!frame_)
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: pages are wished before a frame is open; open one first",
                                dataset_.folder().string()));
    ++counters_.round_trips;
    walk_.reset();
    auto walk = WishWalk::create(frame_, std::move(newest));
    if (!walk) return tl::unexpected(walk.error());
    walk_.emplace(std::move(*walk));
    return {};
}

Result<std::vector<Arrival>> LocalSource::take(SourceDeadline deadline) {
    std::vector<Arrival> chunk;
    std::size_t bytes = 0;
    while (walk_ && chunk.size() < kChunkPages && bytes < kChunkBytes) {
        if (!chunk.empty() && std::chrono::steady_clock::now() >= deadline) break;
        auto step = walk_->next();
        if (!step) {
            walk_.reset();
            break;
        }
        if (step->bytes) {
            bytes += step->bytes->size();
            counters_.bytes_streamed += step->bytes->size();
            ++(step->page.is_block ? counters_.blocks_streamed : counters_.pages_streamed);
        }
        chunk.push_back({step->page, std::move(step->bytes)});
    }
    return chunk;
}

}  // namespace brickyard
