// Accepts connections and starts a session for each. Kept alive by its own handlers, which run on its strand.
#pragma once

#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <memory>

#include "core/result.h"
#include "server/server_context.h"

namespace brickyard {

class Listener : public std::enable_shared_from_this<Listener> {
public:
    Listener(boost::asio::io_context& io, ServerContext& context);

    // Binds and listens; gives the port. Errors: kIo (names the address), kInvalid (no such host).
    Result<std::uint16_t> open();
    void start();
    // Any thread: closes the port.
    void stop();

private:
    void accept();

    boost::asio::io_context& io_;
    ServerContext& context_;
    boost::asio::ip::tcp::acceptor acceptor_;
    boost::asio::steady_timer pause_;
};

}  // namespace brickyard
