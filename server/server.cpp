#include "server/server.h"

#include <spdlog/sinks/stdout_sinks.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <optional>
#include <thread>
#include <vector>

#include "server/listener.h"

namespace brickyard {
namespace {

// How long a goodbye may take before connections are cut.
constexpr std::chrono::milliseconds kGoodbye{2000};

std::shared_ptr<spdlog::logger> makeLog(bool verbose) {
    // Not registered: several servers may run in one process.
    auto log = std::make_shared<spdlog::logger>("brickyard serve",
                                                std::make_shared<spdlog::sinks::stderr_sink_mt>());
    log->set_level(verbose ? spdlog::level::info : spdlog::level::warn);
    return log;
}

}  // namespace

struct Server::State {
    State(std::unique_ptr<const Catalog> catalog, const ServerOptions& options)
        : context(std::move(catalog), options, makeLog(options.verbose)),
          io(int(std::max<std::size_t>(options.threads, 1))),
          work(io.get_executor()) {}

    // Declared in this order: the sessions that `io` still holds when it goes refer to `context`.
    ServerContext context;
    boost::asio::io_context io;
    boost::asio::executor_work_guard<boost::asio::io_context::executor_type> work;
    std::shared_ptr<Listener> listener;
    std::vector<std::thread> threads;
    std::uint16_t port = 0;
};

Server::Server(std::unique_ptr<State> state) : state_(std::move(state)) {}

Server::~Server() { stop(); }

Result<std::unique_ptr<Server>> Server::start(std::unique_ptr<const Catalog> catalog, ServerOptions options) {
    auto state = std::make_unique<State>(std::move(catalog), options);
    state->listener = std::make_shared<Listener>(state->io, state->context);
    const auto port = state->listener->open();
    if (!port) return tl::unexpected(port.error());
    state->port = *port;
    state->listener->start();
    for (std::size_t i = 0; i < std::max<std::size_t>(options.threads, 1); ++i)
        state->threads.emplace_back([raw = state.get()] {
            for (;;) {
                // What one connection throws must not end the others.
                try {
                    raw->io.run();
                    return;
                } catch (const std::exception& error) {
                    raw->context.log->error("a connection ended by an exception: {}", error.what());
                }
            }
        });
    return std::unique_ptr<Server>(new Server(std::move(state)));
}

std::uint16_t Server::port() const { return state_->port; }

void Server::stop() {
    if (state_->threads.empty()) return;
    state_->listener->stop();
    state_->context.connections.closeAll();
    state_->context.connections.waitUntilEmpty(kGoodbye);
    state_->work.reset();
    state_->io.stop();
    for (std::thread& thread : state_->threads) thread.join();
    state_->threads.clear();
}

}  // namespace brickyard
