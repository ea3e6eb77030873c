// The way out of a WebSocket: batches of our own messages, and between two messages the control frames that
// Beast wants to send (pong, ping, close, the answer to the upgrade). Beast's stream stands on this as on a
// socket. One thread.
#pragma once

#include <boost/asio/buffers_iterator.hpp>
#include <functional>
#include <string>

#include "server/out_batch.h"
#include "transport/any_stream.h"

namespace brickyard {

class FrameLane {
public:
    using executor_type = AnyStream::executor_type;
    using ErrorCondition = boost::system::error_code;

    explicit FrameLane(std::unique_ptr<ByteStream> stream)
        : state_(std::make_shared<State>(std::move(stream))) {}
    // What is being written ends, and nobody is told.
    ~FrameLane() { state_->abandon(); }
    FrameLane(const FrameLane&) = delete;
    FrameLane& operator=(const FrameLane&) = delete;
    executor_type get_executor() const { return state_->stream.get_executor(); }
    ByteStream& bytes() { return state_->stream.bytes(); }

    template <class Buffers, class Token>
    auto async_read_some(const Buffers& buffers, Token&& token) {
        return state_->stream.async_read_some(buffers, std::forward<Token>(token));
    }

    // Beast's control frames: few bytes, taken whole.
    template <class Buffers, class Token>
    auto async_write_some(const Buffers& buffers, Token&& token) {
        return boost::asio::async_initiate<Token, void(ErrorCondition, std::size_t)>(
            [](auto handler, State* state, std::string control) {
                state->control = std::move(control);
                state->control_sent = 0;
                state->control_done = OnceHandler(std::move(handler));
                state->go();
            },
            token, state_.get(),
            std::string(boost::asio::buffers_begin(buffers), boost::asio::buffers_end(buffers)));
    }

    // A batch is on its way.
    bool writing() const { return bool(state_->batch); }
    // REQUIRES: !writing(). `done` is called when all of the batch is in the socket, or with an error.
    void write(OutBatch batch, std::function<void(ErrorCondition)> done);
    // The batch's pages that have not begun are not sent any more: a newer wish came.
    void dropPages();
    // Nothing of the batch that has not begun is sent: the connection closes.
    void dropAll();
    // Closes, and lets go of whoever waits for a write.
    void abandon() { state_->abandon(); }
    std::uint64_t sentBytes() const { return state_->sent_total; }

private:
    // Held by the write that is under way as well: Beast's own pings do not keep their stream alive.
    struct State : std::enable_shared_from_this<State> {
        explicit State(std::unique_ptr<ByteStream> the_stream) : stream(std::move(the_stream)) {}
        void abandon();
        // Starts the next write, unless one is under way.
        void go();
        void writeControl();
        void writeBatch();
        // The end of what may be dropped no more: of the message that has begun, and of what the socket was
        // handed.
        std::size_t committed() const;

        AnyStream stream;
        bool busy = false;
        // The peer reads slower than we write: from now on one message at a time is handed over, so that a
        // new wish finds as little as possible on its way.
        bool slow = false;

        std::string control;
        std::size_t control_sent = 0;
        OnceHandler control_done;

        OutBatch batch;
        std::size_t sent = 0;    // of the batch
        std::size_t handed = 0;  // of the batch: the end of the write that is under way
        std::function<void(ErrorCondition)> batch_done;
        std::uint64_t sent_total = 0;
    };

    const std::shared_ptr<State> state_;
};

// What Beast calls to end the connection.
template <class Handler>
void async_teardown(boost::beast::role_type role, FrameLane& lane, Handler&& handler) {
    lane.bytes().asyncShutdown(
        OnceHandler([handler = std::forward<Handler>(handler)](boost::system::error_code error,
                                                               std::size_t) mutable { handler(error); }));
    (void)role;
}
inline void teardown(boost::beast::role_type, FrameLane& lane, boost::system::error_code& error) {
    lane.bytes().socket().close(error);
}
inline void beast_close_socket(FrameLane& lane) { lane.bytes().close(); }

}  // namespace brickyard
