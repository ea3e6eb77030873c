#include "server/http_session.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <boost/asio/post.hpp>
#include <boost/asio/write.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket/rfc6455.hpp>
#include <optional>

#include "server/http_routes.h"
#include "server/stream_session.h"
#include "transport/any_stream.h"

namespace brickyard {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using ErrorCondition = boost::system::error_code;

constexpr std::uint32_t kMaxRequestHeaderBytes = 16u << 10;
constexpr std::uint64_t kMaxRequestBodyBytes = 1u << 10;  // of a GET: read and ignored
constexpr std::size_t kMaxRequestIdBytes = 128, kReadBytes = 4u << 10, kMaxLoggedBytes = 512;

std::string_view viewOf(beast::string_view text) { return {text.data(), text.size()}; }

// A page in a browser may not use its user's way to this server: a browser names the page's origin, which
// must then be the host that the request was sent to, or one that was allowed.
bool isForeignOrigin(const http::fields& request, const std::vector<std::string>& allowed) {
    const auto origin = request.find(http::field::origin);
    if (origin == request.end()) return false;
    std::string_view from = viewOf(origin->value());
    for (const std::string& good : allowed)
        if (good == "*" || good == from) return false;
    if (const auto scheme = from.find("://"); scheme != std::string_view::npos)
        from.remove_prefix(scheme + 3);
    return from != viewOf(request[http::field::host]);
}

// A name for the request that its sender, the log and the answer share; the sender's where it is harmless.
std::string requestIdOf(const http::fields& request, std::uint64_t number) {
    const std::string_view given = viewOf(request["X-Request-Id"]);
    const bool harmless = !given.empty() && given.size() <= kMaxRequestIdBytes &&
                          std::all_of(given.begin(), given.end(), [](char c) { return c > ' ' && c <= '~'; });
    return harmless ? std::string(given) : fmt::format("{:x}", number);
}

class HttpSession : public std::enable_shared_from_this<HttpSession>, private Timed {
public:
    HttpSession(std::unique_ptr<ByteStream> stream, std::unique_ptr<ConnectionList::Slot> slot,
                IoThread& thread, ServerContext& context)
        : Timed(thread),
          thread_(thread),
          stream_(std::move(stream)),
          slot_(std::move(slot)),
          context_(context),
          services_{context.catalog.get(), nullptr, &context.batches, {}} {
        context_.metrics.connectionOpened(Via::kHttp);
    }
    ~HttpSession() override { context_.metrics.connectionClosed(Via::kHttp); }

    void start() {
        slot_->onClose([weak = weak_from_this(), executor = stream_.get_executor()] {
            asio::post(executor, [weak] {
                if (const auto self = weak.lock()) self->leave();
            });
        });
        services_.metrics = [&context = context_] { return metricsText(context); };
        expireAfter(context_.options.handshake_timeout);
        stream_.bytes().asyncHandshake(OnceHandler([self = shared_from_this()](ErrorCondition error,
                                                                               std::size_t) {
            if (error) {
                self->context_.log.write(LogLevel::info, "TLS handshake failed", {{"why", error.message()}});
                self->context_.metrics.error("refused");
                return self->stream_.bytes().close();
            }
            self->read();
        }));
    }

private:
    static std::string metricsText(ServerContext& context) {
        const auto counts = context.catalog->counts();
        Metrics::Gauges now;
        now.queued_bytes = context.batches.usedBytes();
        now.queue_limit_bytes = context.batches.budgetBytes();
        now.wish_bytes = context.wishes.usedBytes();
        now.wish_limit_bytes = context.wishes.limitBytes();
        now.block_cache_bytes = counts.block_cache_bytes;
        now.block_cache_hits = counts.block_cache_hits;
        now.block_cache_misses = counts.block_cache_misses;
        now.open_frames = counts.open_frames;
        now.datasets = counts.datasets;
        now.frames = counts.frames;
        return context.metrics.text(now);
    }

    // The deadline is for the whole request, so that one byte at a time does not put it off.
    void read() {
        if (leaving_) return shutdown();
        idle_ = true;
        parser_.emplace();
        // A body that came with its header is looked at now, not when something else comes.
        parser_->eager(true);
        parser_->header_limit(kMaxRequestHeaderBytes);
        parser_->body_limit(kMaxRequestBodyBytes);
        // What is there of the next request already, from a peer that does not wait for answers.
        // Posted: a thousand of them must not stand on each other's stack.
        if (buffer_.size() > 0)
            return asio::post(stream_.get_executor(), [self = shared_from_this()] { self->parse(); });
        readSome();
    }

    void readSome() {
        if (buffer_.size() == buffer_.max_size()) return refuse(431, "the request's header is over 16 KiB");
        const auto into = buffer_.prepare(std::min(kReadBytes, buffer_.max_size() - buffer_.size()));
        stream_.bytes().asyncReadSome(
            into, OnceHandler([self = shared_from_this()](ErrorCondition error, std::size_t bytes) {
                self->buffer_.commit(bytes);
                if (error == asio::error::eof)
                    error =
                        self->parser_->got_some() ? http::error::partial_message : http::error::end_of_stream;
                if (error) return self->onRead(error);
                self->parse();
            }));
    }

    // As http::async_read does it, with one handler a read instead of several.
    void parse() {
        ErrorCondition error;
        const std::size_t used = parser_->put(buffer_.data(), error);
        buffer_.consume(used);
        if (error == http::error::need_more || (!error && !parser_->is_done())) return readSome();
        onRead(error);
    }

    void onRead(ErrorCondition error) {
        idle_ = false;
        if (error == http::error::end_of_stream || error == http::error::partial_message) return shutdown();
        if (error == http::error::header_limit) return refuse(431, "the request's header is over 16 KiB");
        if (error == http::error::body_limit) return refuse(413, "a request has no body here");
        if (error.category() == http::make_error_code(http::error::bad_method).category())
            return refuse(400, "this is not an HTTP/1.1 request: " + error.message());
        if (error) return;  // a broken or silent peer: nobody is left to tell

        began_ = Clock::now();
        if (beast::websocket::is_upgrade(parser_->get())) return upgrade();
        answer(ReadMode::kCachedOnly);
    }

    HttpRequest request() const {
        const auto& message = parser_->get();
        return {viewOf(message.method_string()), viewOf(message.target()),
                viewOf(message[http::field::if_none_match]), viewOf(message[http::field::authorization])};
    }

    // On the connection's thread from memory alone, else on a worker's, which gives its hold on the session
    // (`held_by_worker`) back with the answer: a session must end on its own thread.
    void answer(ReadMode mode, std::shared_ptr<HttpSession> held_by_worker = nullptr) {
        std::optional<HttpReply> reply;
        // The rest of the session must go on whatever memory one answer wanted.
        try {
            if (mode == ReadMode::kCachedOnly) tokens_ = context_.tokens.get();
            services_.tokens = tokens_.get();
            const auto began = Clock::now();
            reply = answerHttp(request(), services_, mode);
            if (mode == ReadMode::kMayBlock)
                context_.metrics.diskRead(std::chrono::duration<double>(Clock::now() - began).count());
        } catch (const std::exception& error) {
            // Out of memory, in all likelihood.
            context_.log.write(LogLevel::err, "request failed", {{"exception", error.what()}});
            reply.emplace();
            reply->status = 503;
            reply->body = "out of memory; try again later\n";
            context_.metrics.error("memory");
        }
        if (mode == ReadMode::kMayBlock)
            return asio::post(stream_.get_executor(),
                              [self = std::move(held_by_worker), answer = std::move(*reply)]() mutable {
                                  self->write(std::move(answer));
                              });
        if (reply) return write(std::move(*reply));
        expireNever();  // the disk takes as long as it takes
        asio::post(context_.workers(), [self = shared_from_this()]() mutable {
            HttpSession& session = *self;
            session.answer(ReadMode::kMayBlock, std::move(self));
        });
    }

    void upgrade() {
        const auto& message = parser_->get();
        const std::string_view target = viewOf(message.target());
        const std::string_view path = target.substr(0, target.find('?'));
        if (path != "/v1/stream" && path.find('/', 1) != std::string_view::npos)
            return refuse(404, "the stream is at /v1/stream or at /NAME");
        if (isForeignOrigin(message, context_.options.allowed_origins)) {
            context_.metrics.error("refused");
            return refuse(403, "a web page of another origin may not open the stream of this server");
        }
        expireNever();
        startStreamSession(stream_.release(), parser_->release(), std::move(slot_), thread_, context_);
    }

    void refuse(unsigned status, const std::string& why) {
        HttpReply reply;
        reply.status = status;
        reply.headers = "Content-Type: text/plain; charset=utf-8\r\n";
        reply.body = why + "\n";
        keep_alive_ = false;
        write(std::move(reply));
    }

    void write(HttpReply reply) {
        reply_ = std::move(reply);
        const auto& message = parser_->get();
        const bool head_only = message.method() == http::verb::head;
        keep_alive_ = keep_alive_ && !leaving_ && message.keep_alive();
        const std::size_t body_bytes = reply_.page ? reply_.page_bytes : reply_.body.size();
        const std::string id = requestIdOf(message, context_.next_id.fetch_add(1, std::memory_order_relaxed));

        head_.clear();
        const auto status = http::obsolete_reason(http::int_to_status(reply_.status));
        fmt::format_to(std::back_inserter(head_),
                       "HTTP/1.1 {} {}\r\nServer: brickyard\r\nDate: {}\r\nX-Request-Id: {}\r\n",
                       reply_.status, viewOf(status), thread_.date(), id);
        head_ += reply_.headers;
        // A 304 has no length of its own, and HEAD tells the length of what it leaves out.
        if (reply_.status != 304)
            fmt::format_to(std::back_inserter(head_), "Content-Length: {}\r\n", body_bytes);
        if (!keep_alive_)
            head_ += "Connection: close\r\n";
        else if (message.version() < 11)
            head_ += "Connection: keep-alive\r\n";
        head_ += "\r\n";

        sent_bytes_ = head_only || reply_.status == 304 ? 0 : body_bytes;
        expireAfter(context_.options.idle_timeout);
        context_.log.write(LogLevel::debug, "request",
                           {{"id", id},
                            {"method", viewOf(message.method_string())},
                            {"target", viewOf(message.target()).substr(0, kMaxLoggedBytes)},
                            {"status", std::uint64_t(reply_.status)},
                            {"bytes", std::uint64_t(sent_bytes_)}});
        writeRest(asio::buffer(head_), reply_.page ? asio::const_buffer(reply_.page.data(), sent_bytes_)
                                                   : asio::const_buffer(reply_.body.data(), sent_bytes_));
    }

    // Most answers fit the socket as it is: then nothing has to be waited for.
    void writeRest(asio::const_buffer head, asio::const_buffer body) {
        ErrorCondition error;
        const std::size_t written = stream_.bytes().writeNow(WriteBuffers(head, body), error);
        if (error == asio::error::would_block) error = {};
        const std::size_t of_head = std::min(written, head.size());
        head += of_head;
        body += written - of_head;
        if (error || head.size() + body.size() == 0) return onWritten(error);
        asio::async_write(
            stream_, std::array<asio::const_buffer, 2>{head, body},
            [self = shared_from_this()](ErrorCondition failed, std::size_t) { self->onWritten(failed); });
    }

    void onWritten(ErrorCondition error) {
        if (error) return;
        context_.metrics.httpRequest(reply_.route, reply_.status,
                                     std::chrono::duration<double>(Clock::now() - began_).count());
        if (reply_.page_bytes > 0 && sent_bytes_ > 0)
            context_.metrics.pageSent(Via::kHttp, reply_.is_block, sent_bytes_, 0);
        if (reply_.status >= 500) context_.metrics.error(reply_.status == 503 ? "memory" : "disk");
        reply_ = {};
        tokens_.reset();
        if (!keep_alive_) return shutdown();
        expireAfter(context_.options.idle_timeout);
        read();
    }

    // The server stops: what is being answered is answered.
    void leave() {
        leaving_ = true;
        if (idle_) stream_.bytes().close();
    }

    void shutdown() {
        idle_ = false;
        leaving_ = true;
        expireAfter(context_.options.drain_timeout);
        stream_.bytes().asyncShutdown(
            OnceHandler([self = shared_from_this()](ErrorCondition error, std::size_t) {
                if (!error) self->linger();
            }));
    }

    // Until the peer closes as well, or its time is up: a connection that is closed while something of the
    // peer's is unread is reset, and the answer may be lost in that.
    void linger() {
        buffer_.clear();
        stream_.bytes().asyncReadSome(
            buffer_.prepare(kReadBytes),
            OnceHandler([self = shared_from_this()](ErrorCondition error, std::size_t) {
                if (!error) self->linger();
            }));
    }

    void onDeadline() override {
        if (idle_) context_.metrics.error("timeout");
        stream_.bytes().close();
    }

    IoThread& thread_;
    AnyStream stream_;
    std::unique_ptr<ConnectionList::Slot> slot_;
    ServerContext& context_;
    HttpServices services_;
    std::shared_ptr<const AccessTokens> tokens_;  // that this request is checked against
    beast::flat_buffer buffer_{kMaxRequestHeaderBytes + kMaxRequestBodyBytes};
    std::optional<http::request_parser<http::string_body>> parser_;
    HttpReply reply_;
    std::string head_;
    std::size_t sent_bytes_ = 0;  // of the body
    Clock::time_point began_;
    bool keep_alive_ = true, leaving_ = false, idle_ = false;
};

}  // namespace

void startHttpSession(std::unique_ptr<ByteStream> stream, std::unique_ptr<ConnectionList::Slot> slot,
                      IoThread& thread, ServerContext& context) {
    std::make_shared<HttpSession>(std::move(stream), std::move(slot), thread, context)->start();
}

}  // namespace brickyard
