#include "raw_socket.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>

namespace brickyard {

RawSocket::RawSocket(std::uint16_t port, int receive_buffer) {
    socket_ = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (receive_buffer > 0)
        ::setsockopt(socket_, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(port);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    if (::connect(socket_, reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) closed_ = true;
    const int at_once = 1;
    ::setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &at_once, sizeof at_once);
    const timeval patience{.tv_sec = 10, .tv_usec = 0};
    ::setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    const timeval short_patience{.tv_sec = 2, .tv_usec = 0};
    ::setsockopt(socket_, SOL_SOCKET, SO_SNDTIMEO, &short_patience, sizeof short_patience);
}

RawSocket::~RawSocket() {
    if (socket_ >= 0) ::close(socket_);
}

void RawSocket::endSending() { ::shutdown(socket_, SHUT_WR); }

void RawSocket::reset() {
    const linger at_once{.l_onoff = 1, .l_linger = 0};
    ::setsockopt(socket_, SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
    ::close(socket_);
    socket_ = -1;
    closed_ = true;
}

std::string RawSocket::receiveNow(std::size_t max_bytes) {
    std::string some(max_bytes, '\0');
    const ssize_t got = ::recv(socket_, some.data(), some.size(), MSG_DONTWAIT);
    if (got == 0 || (got < 0 && errno != EAGAIN && errno != EWOULDBLOCK)) closed_ = true;
    some.resize(got > 0 ? std::size_t(got) : 0);
    return some;
}

bool RawSocket::send(std::string_view bytes) {
    while (!bytes.empty()) {
        const ssize_t sent = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL);
        if (sent <= 0) return false;
        bytes.remove_prefix(std::size_t(sent));
    }
    return true;
}

std::string RawSocket::receiveSome() {
    char buffer[65536];
    const ssize_t got = ::recv(socket_, buffer, sizeof buffer, 0);
    // A reset is a close as well; only the deadline is not.
    if (got == 0 || (got < 0 && errno != EAGAIN && errno != EWOULDBLOCK)) closed_ = true;
    return got > 0 ? std::string(buffer, std::size_t(got)) : std::string();
}

std::string RawSocket::receiveUntil(std::string_view end) {
    std::string all;
    while (all.find(end) == std::string::npos) {
        const std::string some = receiveSome();
        if (some.empty()) break;
        all += some;
    }
    return all;
}

std::string RawSocket::receiveAll() {
    std::string all;
    for (;;) {
        const std::string some = receiveSome();
        if (some.empty()) return all;
        all += some;
    }
}

bool RawSocket::closes() {
    receiveAll();
    return closed_;
}

RawReply request(std::uint16_t port, std::string_view method, std::string_view target,
                 std::string_view headers) {
    RawSocket socket(port);
    std::string text;
    text.append(method).append(" ").append(target).append(
        " HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n");
    text.append(headers).append("\r\n");
    socket.send(text);
    const std::string all = socket.receiveAll();
    RawReply reply;
    const auto end = all.find("\r\n\r\n");
    reply.head = all.substr(0, end);
    if (end != std::string::npos) reply.body = all.substr(end + 4);
    if (reply.head.starts_with("HTTP/1.1 ")) reply.status = std::atoi(reply.head.c_str() + 9);
    return reply;
}

std::string upgradeRequest(std::string_view path, std::string_view headers) {
    std::string text;
    text.append("GET ").append(path).append(" HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\n");
    text.append(
        "Connection: Upgrade\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
        "dGhlIHNhbXBsZSBub25jZQ==\r\n");
    text.append(headers).append("\r\n");
    return text;
}

std::string webSocketFrame(std::string_view message, int opcode) {
    std::string frame(1, char(0x80 | opcode));
    const std::size_t n = message.size();
    if (n < 126) {
        frame += char(0x80 | n);
    } else if (n < 65536) {
        frame += char(0x80 | 126);
        for (int shift = 8; shift >= 0; shift -= 8) frame += char(n >> shift & 0xff);
    } else {
        frame += char(0x80 | 127);
        for (int shift = 56; shift >= 0; shift -= 8) frame += char(n >> shift & 0xff);
    }
    // A mask of zeros leaves the bytes as they are.
    frame.append(4, '\0');
    frame.append(message);
    return frame;
}

}  // namespace brickyard
