// What a connection still owes its newest wish, as messages. The newest wish replaces the older one; of that
// one nothing more is sent. One thread at a time.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/wish_walk.h"
#include "proto/stream.pb.h"
#include "server/byte_budget.h"
#include "server/metrics.h"
#include "server/out_batch.h"

namespace brickyard {

class WishQueue {
public:
    // Both may be nullptr: no limit, nothing counted. They outlive the queue.
    WishQueue(ByteBudget* budget, Metrics* metrics) : budget_(budget), metrics_(metrics) {}

    // Replaces what is queued. A list that is longer than what is left of the budget is cut short, as if its
    // credit ended there. REQUIRES: `wish` keeps the limits of stream.proto. `frame` is the one it names.
    // Errors: kInvalid (its camera cannot be): nothing is queued then.
    Result<void> replace(const Wish& wish, std::uint32_t frame_number,
                         std::shared_ptr<const FrameReader> frame);
    void clear() { current_.reset(); }
    bool empty() const { return !current_; }

    enum class Step {
        kNothing,  // nothing is left
        kAdded,
        kFull,   // the message does not fit; neededBytes() tells what would
        kWaits,  // only the disk has the next page, and it must not be waited for
    };
    // Adds the next message to a batch.
    Step addTo(OutBatch& batch, ReadMode mode);
    std::size_t neededBytes() const { return needed_bytes_; }

private:
    using Planned = WishWalk::Planned;
    struct Current {
        std::uint64_t epoch = 0;
        std::uint32_t dataset_id = 0;
        std::uint32_t frame = 0;
        bool cut_short = false;
        std::chrono::steady_clock::time_point since;
        WishWalk walk;
        ByteBudget::Share memory;
        std::uint64_t view_bytes = 0;    // of `memory`, for the view
        std::optional<Planned> failure;  // a page that cannot be had, and was not told yet
    };
    Step addDone(OutBatch& batch);
    Step addFailure(OutBatch& batch);
    // The page's header into head_.
    void describe(const WishedPage& page);
    Step addHead(OutBatch& batch, const StreamHeader& header);

    ByteBudget* budget_;
    Metrics* metrics_;
    std::optional<Current> current_;
    std::size_t needed_bytes_ = 0;
    StreamHeader header_;  // kept: its parts are used again for each page
    std::vector<std::byte> head_;
};

}  // namespace brickyard
