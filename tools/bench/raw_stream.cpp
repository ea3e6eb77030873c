#include "tools/bench/raw_stream.h"

#include <arpa/inet.h>
#include <fmt/format.h>
#include <linux/sockios.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/ioctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cstdio>
#include <cstring>
#include <fstream>
#include <thread>
#include <utility>

#include "core/io_error.h"
#include "core/stream_frame.h"

namespace brickyard {
namespace {

constexpr std::chrono::seconds kPatience{30};
constexpr std::size_t kReadBytes = 64u << 10;
constexpr std::size_t kSlowReadBytes = 8u << 10;
constexpr int kPing = 9, kPong = 10, kBinary = 2;

Result<int> connectLoopback(std::uint16_t port, const RawStreamOptions& options) {
    const int socket = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (socket < 0) return ioError("make", "a socket", errno);
    // Before connecting, so that the window never was larger.
    if (options.receive_buffer_bytes > 0)
        ::setsockopt(socket, SOL_SOCKET, SO_RCVBUF, &options.receive_buffer_bytes, sizeof(int));
    const int yes = 1;
    ::setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
    sockaddr_in from{}, to{};
    from.sin_family = to.sin_family = AF_INET;
    from.sin_addr.s_addr = htonl(INADDR_LOOPBACK - 1 + options.source);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    to.sin_port = htons(port);
    // The port is chosen with the peer known: one may serve many peers.
    ::setsockopt(socket, IPPROTO_IP, IP_BIND_ADDRESS_NO_PORT, &yes, sizeof yes);
    if (::bind(socket, reinterpret_cast<const sockaddr*>(&from), sizeof from) != 0 ||
        ::connect(socket, reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) {
        const int error = errno;
        ::close(socket);
        return ioError("connect to", fmt::format("127.0.0.1:{}", port), error);
    }
    return socket;
}

Result<void> sendAll(int socket, const void* data, std::size_t bytes) {
    const char* at = static_cast<const char*>(data);
    while (bytes > 0) {
        const ssize_t sent = ::send(socket, at, bytes, MSG_NOSIGNAL);
        if (sent < 0 && errno == EINTR) continue;
        if (sent <= 0) return ioError("send to", "the server", errno);
        at += sent;
        bytes -= std::size_t(sent);
    }
    return {};
}

}  // namespace

Result<RawStream> RawStream::connect(std::uint16_t port, const RawStreamOptions& options) {
    const Result<int> socket = connectLoopback(port, options);
    if (!socket) return tl::unexpected(socket.error());
    RawStream stream(*socket);
    stream.server_port_ = port;
    const std::string upgrade =
        "GET /v1/stream HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n";
    if (Result<void> sent = sendAll(*socket, upgrade.data(), upgrade.size()); !sent)
        return tl::unexpected(sent.error());
    const auto deadline = Clock::now() + kPatience;
    for (;;) {
        const std::string_view text(reinterpret_cast<const char*>(stream.in_.data()), stream.in_.size());
        if (const auto end = text.find("\r\n\r\n"); end != std::string_view::npos) {
            if (!text.starts_with("HTTP/1.1 101"))
                return fail(ErrorCode::kRefused, fmt::format("127.0.0.1:{} answers an upgrade with: {}", port,
                                                             text.substr(0, 60)));
            stream.begin_ = end + 4;
            stream.bytes_per_second_ = options.bytes_per_second;
            return stream;
        }
        const Result<bool> came = stream.receiveSome(deadline);
        if (!came) return tl::unexpected(came.error());
        if (!*came)
            return fail(ErrorCode::kTimeout, fmt::format("127.0.0.1:{} does not answer an upgrade", port));
    }
}

Result<RawStream> RawStream::open(std::uint16_t port, const std::string& dataset,
                                  const RawStreamOptions& options) {
    Result<RawStream> stream = connect(port, options);
    if (!stream) return stream;
    StreamHeader hello, open;
    hello.mutable_hello()->set_protocol_major(kProtocolMajor);
    hello.mutable_hello()->set_protocol_minor(0);  // no news
    hello.mutable_hello()->set_client("brickyard bench");
    open.mutable_open()->set_dataset(dataset);
    for (const StreamHeader* header : {&hello, &open})
        if (Result<void> sent = stream->send(*header); !sent) return tl::unexpected(sent.error());
    const Result<std::optional<RawMessage>> answer = stream->receive(Clock::now() + kPatience);
    if (!answer) return tl::unexpected(answer.error());
    if (!*answer || !(*answer)->header.has_welcome())
        return fail(ErrorCode::kRefused, fmt::format("127.0.0.1:{} gives no welcome: {}", port,
                                                     *answer ? (*answer)->header.failed().message() : ""));
    return stream;
}

RawStream::RawStream(RawStream&& other) noexcept { *this = std::move(other); }

RawStream& RawStream::operator=(RawStream&& other) noexcept {
    std::swap(socket_, other.socket_);
    server_port_ = other.server_port_;
    bytes_per_second_ = other.bytes_per_second_;
    next_read_ = other.next_read_;
    in_ = std::move(other.in_);
    begin_ = other.begin_;
    return *this;
}

RawStream::~RawStream() {
    if (socket_ >= 0) ::close(socket_);
}

void RawStream::shutdown() { ::shutdown(socket_, SHUT_RDWR); }

Result<void> RawStream::send(const StreamHeader& header) {
    return sendFrame(kBinary, encodeStreamHead(header));
}

Result<void> RawStream::sendFrame(int opcode, std::span<const std::byte> payload) {
    std::vector<std::byte> frame;
    const auto put = [&](std::uint64_t value, int bytes) {
        for (int shift = 8 * (bytes - 1); shift >= 0; shift -= 8)
            frame.push_back(std::byte(value >> shift & 0xff));
    };
    put(0x80u | unsigned(opcode), 1);
    const std::uint64_t size = payload.size();
    if (size < 126) {
        put(0x80u | size, 1);
    } else if (size < 65536) {
        put(0x80u | 126, 1);
        put(size, 2);
    } else {
        put(0x80u | 127, 1);
        put(size, 8);
    }
    // A mask of zeros leaves the bytes as they are.
    put(0, 4);
    frame.insert(frame.end(), payload.begin(), payload.end());
    return sendAll(socket_, frame.data(), frame.size());
}

// False where the deadline passed first.
Result<bool> RawStream::receiveSome(Clock::time_point deadline) {
    if (bytes_per_second_ > 0) {
        if (next_read_ > deadline) {
            std::this_thread::sleep_until(deadline);
            return false;
        }
        std::this_thread::sleep_until(next_read_);
    }
    pollfd ready{socket_, POLLIN, 0};
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(deadline - Clock::now());
    if (::poll(&ready, 1, int(std::max<std::int64_t>(0, left.count()))) <= 0) return false;

    if (begin_ > 0) {
        in_.erase(in_.begin(), in_.begin() + std::ptrdiff_t(begin_));
        begin_ = 0;
    }
    const std::size_t before = in_.size();
    in_.resize(before + (bytes_per_second_ > 0 ? kSlowReadBytes : kReadBytes));
    const ssize_t got = ::recv(socket_, in_.data() + before, in_.size() - before, 0);
    in_.resize(before + std::size_t(std::max<ssize_t>(0, got)));
    if (got < 0 && errno == EINTR) return true;
    if (got < 0) return ioError("receive from", "the server", errno);
    if (got == 0) return fail(ErrorCode::kIo, "the server closed the connection");
    if (bytes_per_second_ > 0)
        next_read_ = std::max(next_read_, Clock::now() - std::chrono::milliseconds(20)) +
                     std::chrono::nanoseconds(std::uint64_t(got) * 1'000'000'000 / bytes_per_second_);
    return true;
}

std::optional<RawMessage> RawStream::cutMessage() {
    for (;;) {
        const std::span<const std::byte> in = std::span(in_).subspan(begin_);
        if (in.size() < 2) return std::nullopt;
        const int opcode = int(in[0]) & 15;
        std::uint64_t size = std::uint64_t(in[1]) & 127;
        std::size_t head = 2;
        if (size >= 126) {
            const std::size_t bytes = size == 126 ? 2 : 8;
            if (in.size() < head + bytes) return std::nullopt;
            size = 0;
            for (std::size_t i = 0; i < bytes; ++i) size = size << 8 | std::uint64_t(in[head + i]);
            head += bytes;
        }
        if (in.size() - head < size) return std::nullopt;
        begin_ += head + size;
        const std::span<const std::byte> payload = in.subspan(head, size);
        if (opcode == kPing) (void)sendFrame(kPong, payload);
        if (opcode != kBinary) continue;
        RawMessage message;
        message.wire_bytes = head + size;
        std::uint32_t header_bytes = 0;
        if (size >= 4) std::memcpy(&header_bytes, payload.data(), 4);
        if (header_bytes > 0 && header_bytes <= size - 4)
            message.header.ParseFromArray(payload.data() + 4, int(header_bytes));
        return message;
    }
}

Result<std::optional<RawMessage>> RawStream::receive(Clock::time_point deadline) {
    for (;;) {
        if (std::optional<RawMessage> message = cutMessage()) {
            // Ten thousand that wait must not each hold what they once received.
            if (begin_ == in_.size()) begin_ = 0, std::vector<std::byte>().swap(in_);
            return message;
        }
        const Result<bool> came = receiveSome(deadline);
        if (!came) return tl::unexpected(came.error());
        if (!*came) return std::nullopt;
    }
}

std::uint64_t RawStream::bytesOnTheWay() const {
    sockaddr_in own{};
    socklen_t length = sizeof own;
    int unread = 0;
    if (::getsockname(socket_, reinterpret_cast<sockaddr*>(&own), &length) != 0 ||
        ::ioctl(socket_, SIOCINQ, &unread) != 0)
        return 0;
    // The server's end: addresses as they lie in memory, ports as numbers, in hexadecimal.
    const std::string ends = fmt::format(" {:08X}:{:04X} {:08X}:{:04X} ", htonl(INADDR_LOOPBACK),
                                         server_port_, own.sin_addr.s_addr, ntohs(own.sin_port));
    std::ifstream table("/proc/net/tcp");
    for (std::string line; std::getline(table, line);) {
        const auto at = line.find(ends);
        unsigned state = 0;
        unsigned long unsent = 0;
        if (at == std::string::npos ||
            std::sscanf(line.c_str() + at + ends.size(), "%x %lx:", &state, &unsent) != 2)
            continue;
        return unsent + std::uint64_t(unread) + (in_.size() - begin_);
    }
    return 0;
}

Result<std::string> loopbackGet(std::uint16_t port, const std::string& path) {
    const Result<int> socket = connectLoopback(port, {});
    if (!socket) return tl::unexpected(socket.error());
    const timeval patience{.tv_sec = kPatience.count(), .tv_usec = 0};
    ::setsockopt(*socket, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
    const std::string request =
        fmt::format("GET {} HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n", path);
    std::string answer;
    if (sendAll(*socket, request.data(), request.size())) {
        char buffer[16384];
        for (ssize_t got = 0; (got = ::recv(*socket, buffer, sizeof buffer, 0)) > 0;)
            answer.append(buffer, std::size_t(got));
    }
    ::close(*socket);
    const auto end = answer.find("\r\n\r\n");
    if (!answer.starts_with("HTTP/1.1 200") || end == std::string::npos)
        return fail(ErrorCode::kRefused, fmt::format("127.0.0.1:{}{} answers: {}", port, path,
                                                     answer.substr(0, answer.find('\r'))));
    return answer.substr(end + 4);
}

Result<void> raiseDescriptorLimit(std::uint64_t wanted) {
    rlimit limit{};
    ::getrlimit(RLIMIT_NOFILE, &limit);
    limit.rlim_cur = limit.rlim_max;
    if (limit.rlim_cur < wanted)
        return fail(
            ErrorCode::kIo,
            fmt::format("{} open files are needed, and {} are allowed; raise the limit (ulimit -Hn), or "
                        "use fewer connections",
                        wanted, limit.rlim_max));
    if (::setrlimit(RLIMIT_NOFILE, &limit) != 0) return ioError("raise", "the limit of open files", errno);
    return {};
}

}  // namespace brickyard
