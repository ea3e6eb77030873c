// The stream over a RawSocket, frame by frame: a client that is as well or as badly behaved as a test wants.
#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "core/page_address.h"
#include "proto/stream.pb.h"
#include "raw_socket.h"

namespace brickyard {

class RawStream {
public:
    // Connects and upgrades.
    explicit RawStream(std::uint16_t port, int receive_buffer = 0, std::string_view headers = "");
    // As the server answered the upgrade.
    const std::string& answer() const { return answer_; }

    // False where the peer has closed, or takes nothing.
    bool send(const StreamHeader& header);
    bool sendFrame(std::string_view message, int opcode = 2);
    // Hello and Open; whether Welcome came.
    bool establish(const std::string& dataset = "tiny", std::uint32_t minor = 1,
                   const std::string& token = "");
    void hello(std::uint32_t minor = 1, const std::string& token = "");

    struct Received {
        StreamHeader header;
        std::string payload;
    };
    // The next message; nothing when the peer has said goodbye, has closed, or says nothing for 10 seconds.
    // Pings are answered on the way.
    std::optional<Received> receive();
    // Of the goodbye, where one was said.
    int closeCode() const { return close_code_; }
    RawSocket& socket() { return socket_; }

private:
    // False where no more comes.
    bool fill(std::size_t bytes);

    RawSocket socket_;
    std::string answer_, in_;
    int close_code_ = 0;
};

// Messages of a client.
std::string textOf(const StreamHeader& header);
StreamHeader openMessage(const std::string& dataset);
StreamHeader openFrameMessage(std::uint32_t dataset_id, std::uint32_t frame);
StreamHeader wishMessage(std::uint64_t epoch, std::uint64_t credit, std::uint32_t frame = 30);
void addPage(StreamHeader& wish, const PageAddress& page);

}  // namespace brickyard
