#include "server/http_session.h"

#include <fmt/format.h>

#include <boost/asio/dispatch.hpp>
#include <boost/asio/post.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/core/tcp_stream.hpp>
#include <boost/beast/http.hpp>
#include <boost/beast/websocket/rfc6455.hpp>
#include <optional>

#include "server/http_routes.h"
#include "server/stream_session.h"

namespace brickyard {
namespace {

namespace asio = boost::asio;
namespace beast = boost::beast;
namespace http = beast::http;
using ErrorCondition = boost::system::error_code;

constexpr std::uint32_t kMaxRequestHeaderBytes = 16u << 10;
constexpr std::uint64_t kMaxRequestBodyBytes = 1u << 10;  // of a GET: read and ignored

// A page in a browser may not use its user's way to this server: a browser names the page's origin, which
// must then be the host that the request was sent to.
bool isForeignOrigin(const http::fields& request) {
    const auto origin = request.find(http::field::origin);
    if (origin == request.end()) return false;
    std::string_view from(origin->value().data(), origin->value().size());
    if (const auto scheme = from.find("://"); scheme != std::string_view::npos)
        from.remove_prefix(scheme + 3);
    const auto host = request[http::field::host];
    return from != std::string_view(host.data(), host.size());
}

std::string textOf(beast::string_view text) { return {text.data(), text.size()}; }

class HttpSession : public std::enable_shared_from_this<HttpSession> {
public:
    HttpSession(asio::ip::tcp::socket socket, std::unique_ptr<ConnectionList::Slot> slot,
                ServerContext& context)
        : stream_(std::move(socket)), slot_(std::move(slot)), context_(context) {}

    void start() {
        slot_->onClose([weak = weak_from_this(), executor = stream_.get_executor()] {
            asio::post(executor, [weak] {
                if (const auto self = weak.lock()) self->stream_.close();
            });
        });
        asio::dispatch(stream_.get_executor(),
                       [self = shared_from_this()] { self->read(self->context_.options.handshake_timeout); });
    }

private:
    void read(std::chrono::milliseconds patience) {
        parser_.emplace();
        parser_->header_limit(kMaxRequestHeaderBytes);
        parser_->body_limit(kMaxRequestBodyBytes);
        stream_.expires_after(patience);
        http::async_read(
            stream_, buffer_, *parser_,
            [self = shared_from_this()](ErrorCondition error, std::size_t) { self->onRead(error); });
    }

    void onRead(ErrorCondition error) {
        if (error == http::error::end_of_stream || error == http::error::partial_message) return shutdown();
        if (error == http::error::header_limit) return refuse(431, "the request's header is over 16 KiB");
        if (error == http::error::body_limit) return refuse(413, "a request has no body here");
        if (error.category() == http::make_error_code(http::error::bad_method).category())
            return refuse(400, "this is not an HTTP/1.1 request: " + error.message());
        if (error) return;  // a broken or silent peer: nobody is left to tell

        if (beast::websocket::is_upgrade(parser_->get())) return upgrade();
        const auto& request = parser_->get();
        HttpRequest plain;
        plain.method = textOf(request.method_string());
        plain.target = textOf(request.target());
        plain.if_none_match = textOf(request[http::field::if_none_match]);
        plain.authorization = textOf(request[http::field::authorization]);
        HttpReply reply;
        // The rest of the session must go on whatever memory one answer wanted.
        try {
            reply = answerHttp(plain, *context_.catalog, context_.options);
        } catch (const std::bad_alloc&) {
            reply.status = 503;
            reply.body = "out of memory; try again later\n";
        }
        write(std::move(reply), request.method() == http::verb::head, request.keep_alive(),
              request.version());
    }

    void upgrade() {
        const auto& request = parser_->get();
        const std::string target = textOf(request.target());
        const std::string path = target.substr(0, target.find('?'));
        if (path != "/v1/stream" && path.find('/', 1) != std::string::npos)
            return refuse(404, "the stream is at /v1/stream or at /NAME");
        if (isForeignOrigin(request))
            return refuse(403, "a web page of another origin may not open the stream of this server");
        stream_.expires_never();
        startStreamSession(stream_.release_socket(), parser_->release(), std::move(slot_), context_);
    }

    void refuse(unsigned status, const std::string& why) {
        HttpReply reply;
        reply.status = status;
        reply.headers.emplace_back("Content-Type", "text/plain; charset=utf-8");
        reply.body = why + "\n";
        write(std::move(reply), false, false, 11);
    }

    void write(HttpReply reply, bool head_only, bool keep_alive, unsigned version) {
        response_ = {};
        response_.version(version);
        response_.result(reply.status);
        response_.set(http::field::server, "brickyard");
        for (const auto& [name, value] : reply.headers) response_.set(name, value);
        response_.keep_alive(keep_alive);
        // A 304 has no length of its own, and HEAD tells the length of what it leaves out.
        if (reply.status != 304) response_.content_length(reply.body.size());
        if (!head_only) response_.body() = std::move(reply.body);
        stream_.expires_after(context_.options.idle_timeout);
        http::async_write(stream_, response_,
                          [self = shared_from_this(), keep_alive](ErrorCondition error, std::size_t) {
                              if (error) return;
                              if (!keep_alive) return self->shutdown();
                              self->read(self->context_.options.idle_timeout);
                          });
    }

    void shutdown() {
        ErrorCondition ignored;
        stream_.socket().shutdown(asio::ip::tcp::socket::shutdown_send, ignored);
    }

    beast::tcp_stream stream_;
    std::unique_ptr<ConnectionList::Slot> slot_;
    ServerContext& context_;
    beast::flat_buffer buffer_{kMaxRequestHeaderBytes + kMaxRequestBodyBytes};
    std::optional<http::request_parser<http::string_body>> parser_;
    http::response<http::string_body> response_;
};

}  // namespace

void startHttpSession(asio::ip::tcp::socket socket, std::unique_ptr<ConnectionList::Slot> slot,
                      ServerContext& context) {
    std::make_shared<HttpSession>(std::move(socket), std::move(slot), context)->start();
}

}  // namespace brickyard
