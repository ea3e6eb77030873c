#include "server/frame_lane.h"

#include <algorithm>
#include <cassert>

namespace brickyard {

namespace asio = boost::asio;

void FrameLane::write(OutBatch batch, std::function<void(ErrorCondition)> done) {
    assert(!writing() && batch && !batch.empty());
    state_->batch = std::move(batch);
    state_->batch_done = std::move(done);
    state_->sent = state_->handed = 0;
    state_->go();
}

void FrameLane::dropPages() {
    if (state_->batch) state_->batch.dropPages(state_->committed());
}

void FrameLane::dropAll() {
    if (state_->batch) state_->batch.dropAll(state_->committed());
}

void FrameLane::State::abandon() {
    stream.bytes().close();
    control_done = {};
    batch_done = {};
    // What is under way still reads from the batch; it goes with the state.
    if (!busy) batch = {};
}

std::size_t FrameLane::State::committed() const {
    return std::max(batch.messageEnd(sent), batch.messageEnd(handed));
}

void FrameLane::State::go() {
    if (busy) return;
    const bool between_messages = !batch || batch.messageEnd(sent) == sent;
    if (control_done && between_messages) return writeControl();
    if (batch) writeBatch();
}

void FrameLane::State::writeControl() {
    busy = true;
    const WriteBuffers rest(asio::buffer(control) + control_sent);
    stream.bytes().asyncWriteSome(
        rest, OnceHandler([state = shared_from_this()](ErrorCondition error, std::size_t bytes) {
            state->busy = false;
            // Nobody is left where the lane went meanwhile.
            if (!state->control_done) return;
            state->control_sent += bytes;
            if (!error && state->control_sent < state->control.size()) return state->go();
            auto done = std::move(state->control_done);
            done(error, state->control_sent);
            // The handler may have started the next write already.
            state->go();
        }));
}

void FrameLane::State::writeBatch() {
    if (sent == batch.size()) {
        const auto done = std::move(batch_done);
        batch = {};
        return done({});
    }
    busy = true;
    handed = batch.size();
    if (slow) {
        const std::size_t end = batch.messageEnd(sent);
        handed = end > sent ? end : batch.messageEnd(sent + 1);
    }
    const WriteBuffers rest(asio::const_buffer(batch.data() + sent, handed - sent));
    stream.bytes().asyncWriteSome(
        rest, OnceHandler([state = shared_from_this()](ErrorCondition error, std::size_t bytes) {
            state->busy = false;
            if (!state->batch_done) return;
            state->sent_total += bytes;
            if (error) {
                const auto done = std::move(state->batch_done);
                state->batch = {};
                done(error);
                // A control frame that waited for the message's end fails as well: who wrote it may hold the
                // session.
                return state->go();
            }
            state->sent += bytes;
            state->slow = state->sent < state->handed;
            state->handed = state->sent;
            state->go();
        }));
}

}  // namespace brickyard
