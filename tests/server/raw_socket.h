// A TCP connection to a server on loopback, byte by byte: for what no well-behaved client sends. Blocking,
// with a deadline on every read.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

namespace brickyard {

class RawSocket {
public:
    // `receive_buffer` is what the system keeps for a reader that is slow; 0 leaves the choice to it.
    explicit RawSocket(std::uint16_t port, int receive_buffer = 0);
    ~RawSocket();
    RawSocket(const RawSocket&) = delete;
    RawSocket& operator=(const RawSocket&) = delete;

    // False where the peer has closed already, or takes nothing for 2 seconds.
    bool send(std::string_view bytes);
    // The end of what is sent (FIN); and the end of everything (RST).
    void endSending();
    void reset();
    // Waits for at least one byte; empty when the peer closed or nothing came for 10 seconds.
    std::string receiveSome();
    // At most so many bytes, without waiting.
    std::string receiveNow(std::size_t max_bytes);
    // Until `end` has come, the peer closed, or nothing comes.
    std::string receiveUntil(std::string_view end);
    // Until the peer closes.
    std::string receiveAll();
    // Whether the peer closes within 10 seconds, whatever it sends until then.
    bool closes();

    int descriptor() const { return socket_; }

private:
    int socket_ = -1;
    bool closed_ = false;
};

struct RawReply {
    int status = 0;
    std::string head, body;
};

// One request on a connection of its own.
RawReply request(std::uint16_t port, std::string_view method, std::string_view target,
                 std::string_view headers = "");

// The upgrade to a WebSocket, and one binary message as a masked frame (RFC 6455, section 5.2).
std::string upgradeRequest(std::string_view path, std::string_view headers = "");
std::string webSocketFrame(std::string_view message, int opcode = 2);

}  // namespace brickyard
