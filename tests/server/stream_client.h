// A client of the stream that a test drives message by message.
#pragma once

#include <condition_variable>
#include <deque>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "client/stream_connection.h"
#include "proto/stream.pb.h"

namespace brickyard {

struct Received {
    StreamHeader header;
    std::vector<std::byte> payload;
};

class StreamClient {
public:
    StreamClient(std::uint16_t port, const std::string& path);

    void send(const StreamHeader& header);
    void sendBytes(std::vector<std::byte> message);
    // The next message; nothing when the connection was lost or nothing came for 10 seconds.
    std::optional<Received> receive();
    // Reads on until the connection is lost; false where it is not within 10 seconds.
    bool isLost();
    // Messages pile up in the sockets until resume().
    void pause();
    void resume();

    // Steps of the conversation. The answers are the callers' to look at.
    void hello(std::uint32_t major = 1, const std::string& token = "");
    std::optional<Received> open(const std::string& dataset);
    std::optional<Received> openFrame(std::uint32_t dataset_id, std::uint32_t frame);

private:
    std::mutex mutex_;
    std::condition_variable changed_;
    std::deque<std::vector<std::byte>> outbox_;
    std::deque<Received> inbox_;
    bool lost_ = false, paused_ = false;
    std::unique_ptr<StreamConnection> connection_;  // last: its thread ends first
};

}  // namespace brickyard
