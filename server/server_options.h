// What a server is told at start. Plain value.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace brickyard {

inline constexpr std::uint16_t kDefaultPort = 8750;

enum class LogFormat { kText, kJson };

struct ServerOptions {
    // A numeric address or a name; loopback unless someone says otherwise.
    std::string host = "127.0.0.1";
    std::uint16_t port = kDefaultPort;  // 0 picks a free one

    // Who may come in: docs/security.md.
    std::string token{};                 // one that opens everything; empty: see token_file
    std::filesystem::path token_file{};  // read again by Server::reload(); empty: nobody is asked for a token
    std::filesystem::path tls_certificate{}, tls_key{};  // PEM, read again by reload(); empty: in the clear
    std::vector<std::string> allowed_origins{};          // of web pages, beside the server's own; "*" is any

    std::size_t threads = 2;       // for connections
    std::size_t disk_threads = 4;  // for what may wait for the disk
    std::string log_level = "warn";
    LogFormat log_format = LogFormat::kText;

    // Limits; docs/protocol.md tells those that a client can meet.
    std::size_t max_connections = 4096;
    std::size_t max_connections_per_address = 0;  // 0: as many as there may be in all
    std::size_t max_open_frames = 64;
    std::uint64_t block_cache_bytes = 256ull << 20;
    std::uint64_t queue_bytes = 512ull << 20;             // of what is on its way to all clients
    std::uint64_t wish_bytes = 256ull << 20;              // of the lists that all clients wish for
    std::chrono::milliseconds handshake_timeout{10'000};  // to a whole request, or to an opened dataset
    // Of a peer that sends nothing, not even pongs, or does not take what it is sent.
    std::chrono::milliseconds idle_timeout{120'000};
    std::chrono::milliseconds drain_timeout{2'000};  // for goodbyes when the server stops
    std::chrono::milliseconds rescan{1'000};         // how often folders are looked at for what is new
};

}  // namespace brickyard
