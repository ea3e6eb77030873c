#include "server/server.h"

#include <algorithm>
#include <boost/asio/post.hpp>
#include <thread>
#include <vector>

#include "server/io_threads.h"
#include "server/listener.h"

namespace brickyard {
namespace {

namespace asio = boost::asio;

Result<std::shared_ptr<const AccessTokens>> loadTokens(const ServerOptions& options) {
    if (options.token_file.empty())
        return options.token.empty() ? std::make_shared<const AccessTokens>()
                                     : std::make_shared<const AccessTokens>(options.token);
    auto tokens = AccessTokens::read(options.token_file);
    if (!tokens) return tl::unexpected(tokens.error());
    return std::make_shared<const AccessTokens>(std::move(*tokens));
}

Result<TlsContext> loadTls(const ServerOptions& options) {
    if (options.tls_certificate.empty() && options.tls_key.empty()) return TlsContext();
    return loadServerTls(options.tls_certificate, options.tls_key);
}

// How late a deadline may be noticed.
std::chrono::milliseconds tickOf(const ServerOptions& options) {
    const auto shortest = std::min(options.handshake_timeout, options.idle_timeout);
    return std::clamp(shortest / 4, std::chrono::milliseconds(10), std::chrono::milliseconds(250));
}

}  // namespace

struct Server::State {
    State(std::unique_ptr<Catalog> catalog, const ServerOptions& options,
          std::shared_ptr<const AccessTokens> tokens, TlsContext tls)
        : context(std::move(catalog), options, std::move(tokens), std::move(tls)) {
        for (std::size_t i = 0; i < std::max<std::size_t>(options.threads, 1); ++i)
            threads.push_back(std::make_unique<IoThread>(tickOf(options), [this](const std::string& what) {
                context.log.write(LogLevel::err, "connection failed", {{"exception", what}});
            }));
        timer.emplace(threads.front()->io());
    }

    // Looks on a worker for what changed in the folders, now and then.
    void watchFolders() {
        timer->expires_after(context.options.rescan);
        timer->async_wait([this](boost::system::error_code error) {
            if (error) return;
            asio::post(context.workers(), [this] {
                const auto changes = context.catalog->refresh();
                for (const std::string& warning : changes.warnings)
                    context.log.write(LogLevel::warn, "dataset not served", {{"why", warning}});
                for (const std::string& name : changes.datasets)
                    context.log.write(LogLevel::info, "dataset changed", {{"name", name}});
                if (changes.names || !changes.datasets.empty()) context.connections.tellNews();
                asio::post(threads.front()->io(), [this] { watchFolders(); });
            });
        });
    }

    // Declared in this order: the sessions that the threads' loops still hold when they go refer to
    // `context`.
    ServerContext context;
    std::vector<std::unique_ptr<IoThread>> threads;
    std::optional<asio::steady_timer> timer;
    std::shared_ptr<Listener> listener;
    std::uint16_t port = 0;
    bool stopped = false;
};

Server::Server(std::unique_ptr<State> state) : state_(std::move(state)) {}

Server::~Server() { stop(); }

Result<std::unique_ptr<Server>> Server::start(std::unique_ptr<Catalog> catalog, ServerOptions options) {
    auto tokens = loadTokens(options);
    if (!tokens) return tl::unexpected(tokens.error());
    auto tls = loadTls(options);
    if (!tls) return tl::unexpected(tls.error());
    auto state = std::make_unique<State>(std::move(catalog), options, std::move(*tokens), std::move(*tls));
    state->listener = std::make_shared<Listener>(state->threads, state->context);
    const auto port = state->listener->open();
    if (!port) return tl::unexpected(port.error());
    state->port = *port;
    state->listener->start();
    State* raw = state.get();
    asio::post(raw->threads.front()->io(), [raw] { raw->watchFolders(); });
    return std::unique_ptr<Server>(new Server(std::move(state)));
}

std::uint16_t Server::port() const { return state_->port; }

Result<void> Server::reload() {
    ServerContext& context = state_->context;
    auto tokens = loadTokens(context.options);
    if (!tokens) return tl::unexpected(tokens.error());
    auto tls = loadTls(context.options);
    if (!tls) return tl::unexpected(tls.error());
    context.tokens.set(std::move(*tokens));
    context.tls.set(std::move(*tls));
    context.connections.tellNews();
    context.log.write(LogLevel::info, "certificate, key and tokens read again");
    return {};
}

void Server::stop() {
    if (state_->stopped) return;
    state_->stopped = true;
    ServerContext& context = state_->context;
    state_->listener->stop();
    context.connections.closeAll();
    context.connections.waitUntilEmpty(context.options.drain_timeout);
    // Workers post to the threads, and threads to the workers: both must end before either's queue goes.
    for (auto& thread : state_->threads) thread->stop();
    // What goes now gives memory back; nobody is left to be told.
    context.batches.forgetWaiting();
    context.pool->stop();
    context.pool->join();
    context.pool.reset();
    for (auto& thread : state_->threads) thread->tellEnd();
}

}  // namespace brickyard
