#include "stream_client.h"

#include "core/stream_frame.h"

namespace brickyard {
namespace {

constexpr std::chrono::seconds kPatience{10};

}  // namespace

StreamClient::StreamClient(std::uint16_t port, const std::string& path) {
    StreamConnection::Handlers handlers;
    handlers.on_open = [] {};
    handlers.on_message = [this](std::span<const std::byte> message) {
        const auto frame = parseStreamFrame(message, {kMaxServerHeaderBytes, 64u << 20});
        const std::lock_guard lock(mutex_);
        if (frame) inbox_.push_back({frame->header, {frame->payload.begin(), frame->payload.end()}});
        changed_.notify_all();
        return !paused_;
    };
    handlers.on_lost = [this](const Error&) {
        const std::lock_guard lock(mutex_);
        lost_ = true;
        changed_.notify_all();
    };
    handlers.next_message = [this] {
        const std::lock_guard lock(mutex_);
        if (outbox_.empty()) return std::vector<std::byte>();
        auto message = std::move(outbox_.front());
        outbox_.pop_front();
        return message;
    };
    StreamAddress address;
    address.host = "127.0.0.1";
    address.port = port;
    address.dataset = path;
    connection_ = std::make_unique<StreamConnection>(address, StreamTimeouts{}, std::move(handlers));
}

void StreamClient::send(const StreamHeader& header) { sendBytes(encodeStreamHead(header)); }

void StreamClient::sendBytes(std::vector<std::byte> message) {
    {
        const std::lock_guard lock(mutex_);
        outbox_.push_back(std::move(message));
    }
    connection_->wakeSender();
}

std::optional<Received> StreamClient::receive() {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, kPatience, [this] { return !inbox_.empty() || lost_; });
    if (inbox_.empty()) return std::nullopt;
    Received received = std::move(inbox_.front());
    inbox_.pop_front();
    return received;
}

bool StreamClient::isLost() {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, kPatience, [this] { return lost_; });
}

void StreamClient::pause() {
    const std::lock_guard lock(mutex_);
    paused_ = true;
}

void StreamClient::resume() {
    {
        const std::lock_guard lock(mutex_);
        paused_ = false;
    }
    connection_->resumeReading();
}

void StreamClient::hello(std::uint32_t major, const std::string& token) {
    StreamHeader header;
    header.mutable_hello()->set_protocol_major(major);
    header.mutable_hello()->set_token(token);
    header.mutable_hello()->set_client("test");
    send(header);
}

std::optional<Received> StreamClient::open(const std::string& dataset) {
    StreamHeader header;
    header.mutable_open()->set_dataset(dataset);
    send(header);
    return receive();
}

std::optional<Received> StreamClient::openFrame(std::uint32_t dataset_id, std::uint32_t frame) {
    StreamHeader header;
    header.mutable_open_frame()->set_dataset_id(dataset_id);
    header.mutable_open_frame()->set_frame(frame);
    send(header);
    return receive();
}

}  // namespace brickyard
