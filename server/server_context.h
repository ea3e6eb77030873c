// What every connection of a server shares. Outlives them all. Any thread.
#pragma once

#include <atomic>
#include <boost/asio/thread_pool.hpp>
#include <memory>
#include <mutex>

#include "server/access_tokens.h"
#include "server/batch_pool.h"
#include "server/byte_budget.h"
#include "server/catalog.h"
#include "server/connection_list.h"
#include "server/metrics.h"
#include "server/server_log.h"
#include "server/server_options.h"
#include "transport/tls_context.h"

namespace brickyard {

// A value that is replaced as a whole while others read it.
template <class T>
class Current {
public:
    explicit Current(T value) : value_(std::move(value)) {}
    T get() const {
        const std::lock_guard lock(mutex_);
        return value_;
    }
    void set(T value) {
        const std::lock_guard lock(mutex_);
        value_ = std::move(value);
    }

private:
    mutable std::mutex mutex_;
    T value_;
};

struct ServerContext {
    ServerContext(std::unique_ptr<Catalog> the_catalog, ServerOptions the_options,
                  std::shared_ptr<const AccessTokens> the_tokens, TlsContext the_tls)
        : catalog(std::move(the_catalog)),
          options(std::move(the_options)),
          log(options),
          tokens(std::move(the_tokens)),
          tls(std::move(the_tls)),
          connections(options.max_connections, options.max_connections_per_address),
          batches(options.queue_bytes),
          wishes(options.wish_bytes),
          pool(std::make_unique<boost::asio::thread_pool>(options.disk_threads)) {}

    const std::unique_ptr<Catalog> catalog;
    const ServerOptions options;
    const ServerLog log;
    Current<std::shared_ptr<const AccessTokens>> tokens;
    Current<TlsContext> tls;  // empty: in the clear
    Metrics metrics;
    ConnectionList connections;
    BatchPool batches;
    ByteBudget wishes;
    std::atomic<std::uint64_t> next_id{1};  // of connections and requests, for the log
    // For what may wait for the disk, or takes long.
    boost::asio::thread_pool& workers() { return *pool; }
    // Ends with the server, before its event loops: what waits in it holds sessions, and those hold on to
    // their loop.
    std::unique_ptr<boost::asio::thread_pool> pool;
};

}  // namespace brickyard
