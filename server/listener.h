// Accepts connections and starts a session for each, on the connection threads in turn. Kept alive by its own
// handlers, which run on the first of them.
#pragma once

#include <boost/asio/ip/tcp.hpp>
#include <boost/asio/steady_timer.hpp>
#include <memory>
#include <vector>

#include "core/result.h"
#include "server/io_threads.h"
#include "server/server_context.h"
#include "transport/byte_stream.h"

namespace brickyard {

class Listener : public std::enable_shared_from_this<Listener> {
public:
    // REQUIRES: at least one thread.
    Listener(const std::vector<std::unique_ptr<IoThread>>& threads, ServerContext& context);
    ~Listener();

    // Binds and listens; gives the port. Errors: kIo (names the address), kInvalid (no such host).
    Result<std::uint16_t> open();
    void start();
    // Any thread: closes the port.
    void stop();

private:
    void accept();
    void acceptWaiting();
    void serve(ByteStream::Socket socket, IoThread& thread);
    void onError(boost::system::error_code error);

    const std::vector<std::unique_ptr<IoThread>>& threads_;
    std::size_t next_thread_ = 0;
    ServerContext& context_;
    boost::asio::ip::tcp::acceptor acceptor_;
    boost::asio::steady_timer pause_;
    int spare_descriptor_ = -1;  // given up to turn somebody away where there is no other
};

}  // namespace brickyard
