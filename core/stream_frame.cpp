#include "core/stream_frame.h"

#include <fmt/format.h>
#include <google/protobuf/stubs/logging.h>

#include <cassert>

namespace brickyard {

Result<StreamFrame> parseStreamFrame(std::span<const std::byte> message, const StreamFrameLimits& limits) {
    constexpr std::size_t kLengthBytes = 4;
    if (message.size() < kLengthBytes)
        return fail(
            ErrorCode::kInvalid,
            fmt::format("a message of {} bytes is too short for its header's length", message.size()));
    std::size_t header_bytes = 0;
    for (std::size_t i = 0; i < kLengthBytes; ++i)
        header_bytes |= std::to_integer<std::size_t>(message[i]) << (8 * i);

    const auto rest = message.subspan(kLengthBytes);
    if (header_bytes > limits.header_bytes)
        return fail(ErrorCode::kInvalid, fmt::format("a header of {} bytes is over the limit of {}",
                                                     header_bytes, limits.header_bytes));
    if (header_bytes > rest.size())
        return fail(ErrorCode::kInvalid, fmt::format("a message claims a header of {} bytes and has {}",
                                                     header_bytes, rest.size()));
    StreamFrame frame;
    frame.payload = rest.subspan(header_bytes);
    if (frame.payload.size() > limits.payload_bytes)
        return fail(ErrorCode::kInvalid, fmt::format("a payload of {} bytes is over the limit of {}",
                                                     frame.payload.size(), limits.payload_bytes));

    // A peer must not be able to fill our log: bad UTF-8 would print a line each.
    const google::protobuf::LogSilencer silence;
    // The limits are far below 2^31, so the length fits the parser's int.
    if (!frame.header.ParseFromArray(rest.data(), int(header_bytes)))
        return fail(ErrorCode::kInvalid, "a header is not a StreamHeader");
    if (frame.header.message_case() == StreamHeader::MESSAGE_NOT_SET)
        return fail(ErrorCode::kInvalid, "a header holds no message of this protocol version");
    return frame;
}

void encodeStreamHeadInto(const StreamHeader& header, std::vector<std::byte>& head) {
    const std::size_t header_bytes = header.ByteSizeLong();
    assert(header_bytes <= 0x7fffffffu);
    head.resize(4 + header_bytes);
    for (std::size_t i = 0; i < 4; ++i) head[i] = std::byte(header_bytes >> (8 * i) & 0xff);
    [[maybe_unused]] const bool written = header.SerializeToArray(head.data() + 4, int(header_bytes));
    assert(written);
}

std::vector<std::byte> encodeStreamHead(const StreamHeader& header) {
    std::vector<std::byte> head;
    encodeStreamHeadInto(header, head);
    return head;
}

}  // namespace brickyard
