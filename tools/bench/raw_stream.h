// A WebSocket to a server on loopback as cheap as one can be: a blocking socket, no thread, no checks of what
// it carries. For thousands of connections that do nothing, and for clients that misbehave. One thread sends
// and one may receive.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "proto/stream.pb.h"

namespace brickyard {

struct RawStreamOptions {
    std::uint8_t source = 1;             // 127.0.0.`source`: each has ports of its own
    int receive_buffer_bytes = 0;        // of the socket; 0: the system's choice
    std::uint64_t bytes_per_second = 0;  // is not read faster than this; 0: as fast as it goes
};

struct RawMessage {
    StreamHeader header;
    std::uint64_t wire_bytes = 0;  // with its WebSocket frame
};

class RawStream {
public:
    using Clock = std::chrono::steady_clock;

    // Upgrades. Errors: kIo, kRefused (another answer than 101).
    static Result<RawStream> connect(std::uint16_t port, const RawStreamOptions& options = {});
    // The same, and says Hello and Open and waits for the Welcome. The dataset's number is 1.
    static Result<RawStream> open(std::uint16_t port, const std::string& dataset,
                                  const RawStreamOptions& options = {});
    RawStream(RawStream&& other) noexcept;
    RawStream& operator=(RawStream&& other) noexcept;
    ~RawStream();

    // Waits while the peer does not read. Errors: kIo.
    Result<void> send(const StreamHeader& header);
    // The next message; nothing where the deadline passed first. Errors: kIo (also: the peer closed).
    Result<std::optional<RawMessage>> receive(Clock::time_point deadline);
    // Ends a receive() or send() that waits in another thread; nothing goes afterwards.
    void shutdown();

    // Bytes that the kernel holds between the two programs, in the server's socket and in ours, and those
    // that were received and are no whole message yet. 0 where /proc/net/tcp does not tell.
    std::uint64_t bytesOnTheWay() const;

private:
    explicit RawStream(int socket) : socket_(socket) {}
    Result<bool> receiveSome(Clock::time_point deadline);
    Result<void> sendFrame(int opcode, std::span<const std::byte> payload);
    // The first frame in in_, cut off it.
    std::optional<RawMessage> cutMessage();

    int socket_ = -1;
    std::uint16_t server_port_ = 0;
    std::uint64_t bytes_per_second_ = 0;
    Clock::time_point next_read_{};
    std::vector<std::byte> in_;
    std::size_t begin_ = 0;  // of what was not cut off yet
};

// The body of GET `path`. Errors: kIo; kRefused (another status than 200).
Result<std::string> loopbackGet(std::uint16_t port, const std::string& path);

// As many descriptors as this process may have at all. Errors: kIo (fewer than `wanted`: the message says
// what to do).
Result<void> raiseDescriptorLimit(std::uint64_t wanted);

}  // namespace brickyard
