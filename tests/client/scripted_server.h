// A server that does what a test says: one connection at a time, answer by answer. For what a real one does
// not do: to be old, to fall silent, to send what was not asked.
#pragma once

#include <atomic>
#include <boost/asio/io_context.hpp>
#include <boost/asio/ip/tcp.hpp>
#include <boost/beast/core/flat_buffer.hpp>
#include <boost/beast/websocket.hpp>
#include <cstdint>
#include <functional>
#include <thread>
#include <vector>

#include "core/stream_frame.h"
#include "proto/stream.pb.h"

namespace brickyard {

class ScriptedServer {
public:
    // Adds to `answers`; false closes the connection behind them.
    using Script = std::function<bool(const StreamHeader& asked, std::vector<StreamHeader>& answers)>;

    explicit ScriptedServer(Script script)
        : acceptor_(io_, {boost::asio::ip::make_address("127.0.0.1"), 0}),
          port_(acceptor_.local_endpoint().port()),
          script_(std::move(script)),
          thread_([this] { serve(); }) {}
    // REQUIRES: every client is gone.
    ~ScriptedServer() {
        ending_ = true;
        boost::system::error_code ignored;
        boost::asio::ip::tcp::socket wake(io_);
        wake.connect(acceptor_.local_endpoint(), ignored);
        thread_.join();
    }
    std::uint16_t port() const { return port_; }

private:
    void serve() {
        while (true) {
            boost::system::error_code error;
            boost::asio::ip::tcp::socket socket(io_);
            acceptor_.accept(socket, error);
            if (ending_ || error) return;
            boost::beast::websocket::stream<boost::asio::ip::tcp::socket> stream(std::move(socket));
            stream.accept(error);
            stream.binary(true);
            bool open = !error;
            while (open) {
                boost::beast::flat_buffer in;
                stream.read(in, error);
                if (error) break;
                const auto asked =
                    parseStreamFrame({static_cast<const std::byte*>(in.data().data()), in.size()},
                                     {kMaxClientMessageBytes, 0});
                std::vector<StreamHeader> answers;
                open = asked && script_(asked->header, answers);
                for (const StreamHeader& answer : answers)
                    stream.write(boost::asio::buffer(encodeStreamHead(answer)), error);
            }
            if (!error) stream.close({}, error);
        }
    }

    boost::asio::io_context io_;
    boost::asio::ip::tcp::acceptor acceptor_;
    const std::uint16_t port_;
    const Script script_;
    std::atomic<bool> ending_{false};
    std::thread thread_;
};

}  // namespace brickyard
