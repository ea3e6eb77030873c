// What a server is told at start. Plain value.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>

namespace brickyard {

inline constexpr std::uint16_t kDefaultPort = 8750;

struct ServerOptions {
    // A numeric address or a name; loopback unless someone says otherwise.
    std::string host = "127.0.0.1";
    std::uint16_t port = kDefaultPort;  // 0 picks a free one
    std::string token{};                // empty: nobody is asked for one
    std::size_t threads = 2;
    bool verbose = false;  // one log line per connection, on stderr

    // Limits; docs/protocol.md tells those that a client can meet.
    std::size_t max_connections = 256;
    std::size_t max_open_frames = 64;
    std::uint64_t block_cache_bytes = 256ull << 20;
    std::chrono::milliseconds handshake_timeout{10'000};  // from the first byte to an opened dataset
    std::chrono::milliseconds idle_timeout{
        120'000};  // of a peer that sends nothing, not even pongs, or reads nothing
};

}  // namespace brickyard
