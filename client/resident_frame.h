// What a client holds of one frame of a dataset: decoded bricks, and the tree blocks of the channels it has
// drawn. Kept from picture to picture (RenderRequest::kept), so that a camera that moves, or a scene that is
// edited, streams only what it has not got. The picture is the same, bit for bit, as from nothing.
// docs/page-cache.md.
//
// One picture at a time: during a pass any thread may read, everything else belongs to the renderer's thread.
#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "client/page_cache.h"
#include "client/paged_channel.h"
#include "core/result.h"
#include "proto/dataset.pb.h"

namespace brickyard {

class ResidentFrame {
public:
    // Before each picture. Begins empty where the frame or the budget is another than before: a footer holds
    // the checksums of its tree blocks and those the checksums of their bricks, so one footer is one frame,
    // whatever source it comes from. `file_bytes`: of the frame file, as PagedChannel::create takes it.
    // `components`: most that a channel's pages will have. Errors: kCorrupt (no brick edge); kInvalid (the
    // budget holds no brick).
    Result<void> begin(const FrameFooter& footer, std::uint64_t file_bytes, std::uint64_t budget_bytes,
                       int components = 1);

    // Made when first asked for; stays where it is until begin() is called with another frame.
    // REQUIRES: begin() was successful, `index` is one of the footer's channels. Errors: those of
    // PagedChannel::create.
    Result<PagedChannel*> channel(std::uint32_t index);
    // Those that were asked for, by index in the footer.
    const std::map<std::uint32_t, PagedChannel>& channels() const { return channels_; }
    // Most that a channel's pages can have.
    int components() const { return components_; }
    // False until begin() was successful for the first time.
    bool begun() const { return cache_.has_value(); }
    // REQUIRES: begin() was successful.
    PageCache& cache() { return *cache_; }
    const PageCache& cache() const { return *cache_; }
    // Memory of the tree blocks that have arrived, of all channels; not part of the budget.
    std::uint64_t treeBytes() const;

private:
    std::string stored_footer_;  // as serialised; tells one frame from another
    FrameFooter footer_;
    std::uint64_t file_bytes_ = 0, budget_bytes_ = 0;
    int components_ = 0;
    std::map<std::uint32_t, PagedChannel> channels_;  // a map keeps them in place
    std::optional<PageCache> cache_;
};

}  // namespace brickyard
