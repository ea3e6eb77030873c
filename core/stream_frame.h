// One message of the stream as bytes: u32 little-endian length of the header, the header, the payload to the
// end. docs/protocol.md, section "Messages". Pure functions, any thread.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/result.h"
#include "proto/stream.pb.h"

namespace brickyard {

inline constexpr std::uint32_t kProtocolMajor = 1;
inline constexpr std::uint32_t kProtocolMinor = 1;

// A whole message from a client; more closes the connection.
inline constexpr std::size_t kMaxClientMessageBytes = 1u << 20;
// The header of a message from a server: a manifest or a footer can be long.
inline constexpr std::size_t kMaxServerHeaderBytes = 64u << 20;

struct StreamFrameLimits {
    std::size_t header_bytes = 0;
    std::size_t payload_bytes = 0;
};

struct StreamFrame {
    StreamHeader header;
    std::span<const std::byte> payload;  // within the message that was parsed
};

// Errors: kInvalid (shorter than it claims, over a limit, not a header, or a header that says nothing).
// Allocates in proportion to the message, never to what it claims.
Result<StreamFrame> parseStreamFrame(std::span<const std::byte> message, const StreamFrameLimits& limits);

// Length and header; the payload, if any, is sent right behind these bytes.
std::vector<std::byte> encodeStreamHead(const StreamHeader& header);
// The same into a vector that is used again and again.
void encodeStreamHeadInto(const StreamHeader& header, std::vector<std::byte>& head);

}  // namespace brickyard
