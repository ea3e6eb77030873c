// What a connection still owes its newest wish, as messages. The newest wish replaces the older one; of that
// one nothing more is sent. One thread at a time.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <vector>

#include "core/wish_walk.h"
#include "proto/stream.pb.h"

namespace brickyard {

// One message of the stream, ready to be written: length and header, then the payload.
struct OutMessage {
    std::vector<std::byte> head;
    std::vector<std::byte> payload;
};

class WishQueue {
public:
    // Replaces what is queued. REQUIRES: `wish` keeps the limits of stream.proto. `frame` is the one it
    // names. Errors: kInvalid (its camera cannot be): nothing is queued then.
    Result<void> replace(const Wish& wish, std::shared_ptr<const FrameReader> frame);

    // The next message, read from the disk now; nothing where there is none.
    std::optional<OutMessage> next();

private:
    struct Current {
        std::uint64_t epoch = 0;
        std::uint32_t dataset_id = 0;
        std::uint32_t frame = 0;
        WishWalk walk;
    };
    StreamHeader describe(const WishWalk::Step& step) const;

    std::optional<Current> current_;
};

}  // namespace brickyard
