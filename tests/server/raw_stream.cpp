#include "raw_stream.h"

#include "core/stream_frame.h"

namespace brickyard {

RawStream::RawStream(std::uint16_t port, int receive_buffer, std::string_view headers)
    : socket_(port, receive_buffer) {
    socket_.send(upgradeRequest("/v1/stream", headers));
    const std::string all = socket_.receiveUntil("\r\n\r\n");
    const auto end = all.find("\r\n\r\n");
    answer_ = all.substr(0, end);
    if (end != std::string::npos) in_ = all.substr(end + 4);
}

bool RawStream::send(const StreamHeader& header) { return sendFrame(textOf(header)); }
bool RawStream::sendFrame(std::string_view message, int opcode) {
    return socket_.send(webSocketFrame(message, opcode));
}

void RawStream::hello(std::uint32_t minor, const std::string& token) {
    StreamHeader header;
    header.mutable_hello()->set_protocol_major(kProtocolMajor);
    header.mutable_hello()->set_protocol_minor(minor);
    header.mutable_hello()->set_token(token);
    send(header);
}

bool RawStream::establish(const std::string& dataset, std::uint32_t minor, const std::string& token) {
    hello(minor, token);
    send(openMessage(dataset));
    const auto welcome = receive();
    return welcome && welcome->header.has_welcome();
}

bool RawStream::fill(std::size_t bytes) {
    while (in_.size() < bytes) {
        const std::string some = socket_.receiveSome();
        if (some.empty()) return false;
        in_ += some;
    }
    return true;
}

std::optional<RawStream::Received> RawStream::receive() {
    while (fill(2)) {
        const auto at = [&](std::size_t i) { return std::size_t(static_cast<unsigned char>(in_[i])); };
        const int opcode = int(at(0) & 15);
        std::size_t length = at(1) & 127, head = 2;
        if (length >= 126) {
            const std::size_t digits = length == 126 ? 2 : 8;
            if (!fill(2 + digits)) return std::nullopt;
            length = 0;
            for (std::size_t i = 0; i < digits; ++i) length = length << 8 | at(head++);
        }
        if (!fill(head + length)) return std::nullopt;
        std::string message = in_.substr(head, length);
        in_.erase(0, head + length);
        if (opcode == 9) sendFrame(message, 10);
        if (opcode == 8) {
            if (message.size() >= 2)
                close_code_ =
                    static_cast<unsigned char>(message[0]) << 8 | static_cast<unsigned char>(message[1]);
            sendFrame(message, 8);
            return std::nullopt;
        }
        if (opcode != 2) continue;
        const auto frame =
            parseStreamFrame(std::as_bytes(std::span(message)), {kMaxServerHeaderBytes, 64u << 20});
        if (!frame) return std::nullopt;
        return Received{frame->header,
                        {reinterpret_cast<const char*>(frame->payload.data()), frame->payload.size()}};
    }
    return std::nullopt;
}

std::string textOf(const StreamHeader& header) {
    const auto bytes = encodeStreamHead(header);
    return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

StreamHeader openMessage(const std::string& dataset) {
    StreamHeader header;
    header.mutable_open()->set_dataset(dataset);
    return header;
}

StreamHeader openFrameMessage(std::uint32_t dataset_id, std::uint32_t frame) {
    StreamHeader header;
    header.mutable_open_frame()->set_dataset_id(dataset_id);
    header.mutable_open_frame()->set_frame(frame);
    return header;
}

StreamHeader wishMessage(std::uint64_t epoch, std::uint64_t credit, std::uint32_t frame) {
    StreamHeader header;
    Wish& wish = *header.mutable_wish();
    wish.set_epoch(epoch);
    wish.set_dataset_id(1);
    wish.set_frame(frame);
    wish.set_credit_bytes(credit);
    return header;
}

void addPage(StreamHeader& wish, const PageAddress& page) {
    PageRef& ref = *wish.mutable_wish()->add_pages();
    ref.set_channel(page.channel);
    ref.set_block(page.block);
    ref.set_node(page.node);
}

}  // namespace brickyard
