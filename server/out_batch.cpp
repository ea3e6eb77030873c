#include "server/out_batch.h"

#include <algorithm>
#include <cassert>

namespace brickyard {
namespace {

constexpr std::size_t kShort = 125, kMedium = 0xffff;
constexpr std::uint8_t kFinalBinary = 0x82;

std::size_t headerBytes(std::size_t message_bytes) {
    return message_bytes <= kShort ? 2 : message_bytes <= kMedium ? 4 : 10;
}

}  // namespace

std::size_t OutBatch::framedBytes(std::size_t message_bytes) {
    return headerBytes(message_bytes) + message_bytes;
}

std::span<std::byte> OutBatch::add(std::span<const std::byte> head, std::size_t payload_bytes, bool is_page) {
    const std::size_t bytes = head.size() + payload_bytes;
    assert(fits(bytes));
    const std::size_t begin = size();
    std::byte* at = memory_.data() + begin;
    *at++ = std::byte(kFinalBinary);
    const std::size_t header = headerBytes(bytes);
    const std::size_t length_bytes = header - 2;
    *at++ = std::byte(length_bytes == 0 ? bytes : length_bytes == 2 ? 126 : 127);
    for (std::size_t i = 0; i < length_bytes; ++i)
        *at++ = std::byte(bytes >> (8 * (length_bytes - 1 - i)) & 0xff);
    at = std::copy(head.begin(), head.end(), at);
    messages_.push_back({begin, begin + header + bytes, is_page});
    return {at, payload_bytes};
}

std::size_t OutBatch::messageEnd(std::size_t at) const {
    const auto next = std::partition_point(messages_.begin(), messages_.end(),
                                           [&](const Message& message) { return message.end <= at; });
    return next == messages_.end() || next->begin >= at ? at : next->end;
}

void OutBatch::dropPages(std::size_t from) {
    while (!messages_.empty() && messages_.back().is_page && messages_.back().begin >= from)
        messages_.pop_back();
}

void OutBatch::dropAll(std::size_t from) {
    while (!messages_.empty() && messages_.back().begin >= from) messages_.pop_back();
}

}  // namespace brickyard
