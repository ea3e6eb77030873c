#include "server/frame_lane.h"

#include <algorithm>
#include <cassert>

namespace brickyard {

namespace asio = boost::asio;

void FrameLane::write(OutBatch batch, std::function<void(ErrorCondition)> done) {
    assert(!writing() && batch && !batch.empty());
    batch_ = std::move(batch);
    batch_done_ = std::move(done);
    sent_ = handed_ = 0;
    go();
}

std::size_t FrameLane::committed() const {
    return std::max(batch_.messageEnd(sent_), batch_.messageEnd(handed_));
}

void FrameLane::dropPages() {
    if (batch_) batch_.dropPages(committed());
}

void FrameLane::dropAll() {
    if (batch_) batch_.dropAll(committed());
}

void FrameLane::go() {
    if (busy_) return;
    const bool between_messages = !batch_ || batch_.messageEnd(sent_) == sent_;
    if (control_done_ && between_messages) return writeControl();
    if (batch_) writeBatch();
}

void FrameLane::writeControl() {
    busy_ = true;
    const WriteBuffers rest(asio::buffer(control_) + control_sent_);
    stream_.bytes().asyncWriteSome(rest, OnceHandler([this](ErrorCondition error, std::size_t bytes) {
                                       busy_ = false;
                                       control_sent_ += bytes;
                                       if (!error && control_sent_ < control_.size()) return go();
                                       auto done = std::move(control_done_);
                                       done(error, control_sent_);
                                       // The handler may have started the next write already.
                                       go();
                                   }));
}

void FrameLane::writeBatch() {
    if (sent_ == batch_.size()) {
        const auto done = std::move(batch_done_);
        batch_ = {};
        return done({});
    }
    busy_ = true;
    handed_ = batch_.size();
    if (slow_) {
        const std::size_t end = batch_.messageEnd(sent_);
        handed_ = end > sent_ ? end : batch_.messageEnd(sent_ + 1);
    }
    const WriteBuffers rest(asio::const_buffer(batch_.data() + sent_, handed_ - sent_));
    stream_.bytes().asyncWriteSome(rest, OnceHandler([this](ErrorCondition error, std::size_t bytes) {
                                       busy_ = false;
                                       sent_total_ += bytes;
                                       if (error) {
                                           const auto done = std::move(batch_done_);
                                           batch_ = {};
                                           return done(error);
                                       }
                                       sent_ += bytes;
                                       slow_ = sent_ < handed_;
                                       handed_ = sent_;
                                       go();
                                   }));
}

}  // namespace brickyard
