// Any bytes as a message of the stream: refused, or the same message when written again.
#include <algorithm>
#include <cstdlib>
#include <cstring>

#include "core/stream_frame.h"
#include "stream_messages.h"

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t max_size);

// Now and then a sound message takes the input's place, and is then mutated as any other.
extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t max_size,
                                               unsigned seed) {
    using namespace brickyard;
    Dice dice(seed);
    if (dice.once(16)) {
        const auto message = encodeStreamHead(randomMessage(dice));
        if (message.size() <= max_size) {
            std::memcpy(data, message.data(), message.size());
            size = message.size();
        }
    }
    return LLVMFuzzerMutate(data, size, max_size);
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    using namespace brickyard;
    const auto message = std::as_bytes(std::span(data, size));
    const StreamFrameLimits limits{.header_bytes = kMaxClientMessageBytes, .payload_bytes = 4096};
    const auto frame = parseStreamFrame(message, limits);
    if (!frame) return 0;
    auto again = encodeStreamHead(frame->header);
    again.insert(again.end(), frame->payload.begin(), frame->payload.end());
    // Bytes need not be equal (a number may be written in more bytes than it needs), meaning must be.
    const auto second =
        parseStreamFrame(again, {.header_bytes = 2 * kMaxClientMessageBytes, .payload_bytes = 4096});
    if (!second || second->header.SerializeAsString() != frame->header.SerializeAsString() ||
        second->payload.size() != frame->payload.size())
        std::abort();
    return 0;
}
