// One frame of one dataset on its way from a source into memory: wishes go out, and what comes is verified,
// decoded and kept. One thread; rays of other threads may read cache and channels between two takes.
#pragma once

#include <string>
#include <unordered_set>
#include <vector>

#include "client/brick_source.h"
#include "client/cpu/want_list.h"
#include "client/resident_frame.h"
#include "core/result.h"

namespace brickyard {

class FrameStream {
public:
    // `source` and `kept` outlive the stream. `kept` may be nullptr: what comes goes with the stream.
    FrameStream(BrickSource& source, ResidentFrame* kept) : source_(source), held_(kept ? *kept : own_) {}

    // Waits for the footer. Errors: those of BrickSource::openFrame.
    Result<FrameFooter> open(std::uint32_t frame, SourceDeadline deadline);
    // What is kept of the frame is used. `footer`: that of open(), its transforms perhaps changed by a scene.
    // `components`: most of a channel that will be read. Errors: those of ResidentFrame::begin.
    // REQUIRES: open() was successful.
    Result<void> begin(const FrameFooter& footer, std::uint64_t cache_bytes, int components = 1);
    // A channel whose pages are taken in from now on; the same object for the same index. Errors: those of
    // PagedChannel::create. REQUIRES: begin() was successful.
    Result<PagedChannel*> channel(std::uint32_t index);

    // Sends the wish and takes in what comes, until it is done or the deadline has passed. Pages that cannot
    // be had are failed(); errors are those of the source as a whole.
    Result<void> take(const PageWish& wish, SourceDeadline deadline);
    // The wish for what rays missed, what helps most per byte first; where not all fits into the cache, what
    // the first tiles want first. At most `allowed_bytes`; `over_budget` is set where that left something
    // out. Empty: nothing more may come.
    PageWish wishFor(const WantList& wants, std::uint64_t allowed_bytes, bool& over_budget) const;

    BrickSource& source() { return source_; }
    std::uint32_t frame() const { return frame_; }
    PageCache& cache() { return held_.cache(); }
    const PageCache& cache() const { return held_.cache(); }
    // Since begin().
    PageCacheCounters counters() const { return cache().counters() - counted_before_; }
    std::uint64_t treeBytes() const { return held_.treeBytes(); }
    // What cannot be had, and why the first of it: names dataset, frame, channel and brick.
    const std::unordered_set<WantedPage, WantedPageHash>& failed() const { return failed_; }
    const std::string& firstFailure() const { return first_failure_; }
    // Pages and blocks that came damaged and were asked for once more.
    std::size_t retried() const { return retried_.size(); }
    // Of the newest wish: what came in as long as its first page took.
    std::uint64_t inFlightBytes() const { return in_flight_bytes_; }

private:
    void arrive(const Arrival& arrival);
    PagedChannel* channelOf(std::uint32_t index) const;

    BrickSource& source_;
    ResidentFrame own_;  // where nothing is kept
    ResidentFrame& held_;
    std::uint32_t frame_ = 0;
    std::uint64_t file_bytes_ = UINT64_MAX;
    std::vector<PagedChannel*> channels_;
    PageCacheCounters counted_before_;
    std::unordered_set<WantedPage, WantedPageHash> failed_, retried_;
    std::string first_failure_;
    std::uint64_t in_flight_bytes_ = 0;
};

}  // namespace brickyard
