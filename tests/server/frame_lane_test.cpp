// The way out of a WebSocket over a stream that takes as few bytes as it likes, and fails when it likes.
#include "server/frame_lane.h"

#include <gmock/gmock.h>

#include <boost/asio/post.hpp>
#include <random>

namespace brickyard {
namespace {

namespace asio = boost::asio;
using ErrorCondition = boost::system::error_code;

// What was written, and how far each write may go.
struct Wire {
    std::string written;
    std::mt19937 dice{1};
    std::size_t fails_after = SIZE_MAX;  // bytes
};

class FakeStream final : public ByteStream {
public:
    FakeStream(asio::io_context& io, Wire& wire) : socket_(io), wire_(wire) {}
    Socket& socket() override { return socket_; }
    void asyncHandshake(OnceHandler) override {}
    void asyncReadSome(asio::mutable_buffer, OnceHandler) override {}
    void asyncWriteSome(WriteBuffers from, OnceHandler done) override {
        asio::post(socket_.get_executor(), [this, from, done = std::move(done)]() mutable {
            std::size_t room = 1 + wire_.dice() % (wire_.dice() % 4 == 0 ? 20'000 : 50);
            room = std::min(room, wire_.fails_after - wire_.written.size());
            if (room == 0) return done(asio::error::connection_reset, 0);
            std::size_t sent = 0;
            for (const asio::const_buffer& buffer : from) {
                const std::size_t some = std::min(room - sent, buffer.size());
                wire_.written.append(static_cast<const char*>(buffer.data()), some);
                sent += some;
            }
            done({}, sent);
        });
    }
    std::size_t writeNow(const WriteBuffers&, ErrorCondition& error) override {
        error = asio::error::would_block;
        return 0;
    }
    void asyncShutdown(OnceHandler) override {}
    std::string encryption() const override { return {}; }

private:
    Socket socket_;
    Wire& wire_;
};

class FrameLaneTest : public testing::Test {
protected:
    void SetUp() override { lane_ = std::make_unique<FrameLane>(std::make_unique<FakeStream>(io_, wire_)); }
    // `answers` messages "a...", then `pages` messages "p...".
    OutBatch batchOf(std::size_t answers, std::size_t pages) {
        OutBatch batch(pool_.take());
        for (std::size_t i = 0; i < answers + pages; ++i) {
            const bool is_page = i >= answers;
            const std::string text(1 + wire_.dice() % 300, is_page ? 'p' : 'a');
            batch.add(std::as_bytes(std::span(text)), 0, is_page);
        }
        return batch;
    }
    void writeControl(const std::string& frame) {
        ++controls_pending_;
        lane_->async_write_some(asio::buffer(frame), [this](ErrorCondition error, std::size_t bytes) {
            --controls_pending_;
            if (error) ++control_errors_;
            control_bytes_ += bytes;
        });
    }
    void run() {
        io_.restart();
        io_.run();
    }
    // The messages that went out, each as its first letter; "?" for what is no whole frame.
    std::string sent() const {
        std::string kinds;
        std::size_t at = 0;
        while (at + 2 <= wire_.written.size()) {
            const auto byte = [&](std::size_t i) {
                return std::size_t(static_cast<unsigned char>(wire_.written[at + i]));
            };
            if (byte(0) != 0x82 && byte(0) != 0x8a) return kinds + "?";
            std::size_t length = byte(1), head = 2;
            if (length == 126) length = byte(2) << 8 | byte(3), head = 4;
            if (at + head + length > wire_.written.size()) return kinds + "?";
            const std::string text = wire_.written.substr(at + head, length);
            if (text.find_first_not_of(text[0]) != std::string::npos) return kinds + "?";
            kinds += text[0];
            at += head + length;
        }
        return at == wire_.written.size() ? kinds : kinds + "?";
    }

    asio::io_context io_;
    Wire wire_;
    BatchPool pool_{8 * kBatchBytes};
    std::unique_ptr<FrameLane> lane_;
    int controls_pending_ = 0, control_errors_ = 0;
    std::size_t control_bytes_ = 0;
};

const std::string kPong =
    "\x8a\x05"
    "ccccc";

TEST_F(FrameLaneTest, SendsWholeMessagesAndControlFramesOnlyBetweenThem) {
    for (int round = 0; round < 300; ++round) {
        wire_.written.clear();
        const std::size_t answers = wire_.dice() % 4, pages = 1 + wire_.dice() % 12;
        int ends = 0;
        lane_->write(batchOf(answers, pages), [&](ErrorCondition error) {
            EXPECT_FALSE(error);
            ++ends;
        });
        // A control frame at a time, as Beast has it, whenever; and once a newer wish, or the end.
        const bool drops_pages = wire_.dice() % 3 == 0, drops_all = !drops_pages && wire_.dice() % 3 == 0;
        const std::size_t drop_at = wire_.dice() % 8;
        std::size_t controls = 0;
        io_.restart();
        for (std::size_t step = 0; ends == 0 || controls_pending_ > 0; ++step) {
            if (controls_pending_ == 0 && wire_.dice() % 3 == 0 && controls < 20 && ends == 0) {
                writeControl(kPong);
                ++controls;
            }
            if (step == drop_at && lane_->writing()) {
                if (drops_pages) lane_->dropPages();
                if (drops_all) lane_->dropAll();
            }
            if (io_.run_one() == 0) io_.restart();
            ASSERT_LT(step, 100'000u);
        }
        const std::string kinds = sent();
        ASSERT_EQ(kinds.find('?'), std::string::npos) << kinds;
        const auto count = [&](char kind) {
            return std::size_t(std::count(kinds.begin(), kinds.end(), kind));
        };
        ASSERT_EQ(count('c'), controls);
        if (!drops_all) ASSERT_EQ(count('a'), answers) << "an answer was dropped";
        if (!drops_all && !drops_pages) ASSERT_EQ(count('p'), pages);
        ASSERT_EQ(ends, 1);
        ASSERT_FALSE(lane_->writing());
        ASSERT_EQ(pool_.usedBytes(), 0u);
    }
}

TEST_F(FrameLaneTest, AControlFrameThatWaitsFailsWithTheMessageBeforeIt) {
    for (std::size_t fails_after = 0; fails_after < 400; fails_after += 7) {
        wire_ = {};
        wire_.fails_after = fails_after;
        SetUp();
        int failed = 0;
        lane_->write(batchOf(1, 3), [&](ErrorCondition error) { failed += error ? 1 : 0; });
        writeControl(kPong);
        run();
        EXPECT_EQ(controls_pending_, 0) << "nobody told who wrote the control frame, after " << fails_after;
        EXPECT_FALSE(lane_->writing());
        EXPECT_EQ(pool_.usedBytes(), 0u);
    }
    EXPECT_GT(control_errors_, 0);
}

TEST_F(FrameLaneTest, MayGoWhileSomethingIsWritten) {
    for (std::size_t steps = 0; steps < 20; ++steps) {
        SetUp();
        lane_->write(batchOf(2, 3), [](ErrorCondition) {});
        lane_->async_write_some(asio::buffer(kPong), [](ErrorCondition, std::size_t) {});
        io_.restart();
        for (std::size_t i = 0; i < steps; ++i) io_.run_one();
        lane_.reset();
        run();
        EXPECT_EQ(pool_.usedBytes(), 0u) << steps;
    }
}

// Whoever is told may let go of the lane.
TEST_F(FrameLaneTest, MayGoWhenSomebodyIsTold) {
    lane_->async_write_some(asio::buffer(kPong), [this](ErrorCondition, std::size_t) { lane_.reset(); });
    run();
    SetUp();
    lane_->write(batchOf(1, 0), [this](ErrorCondition) { lane_.reset(); });
    run();
    EXPECT_EQ(lane_, nullptr);
    EXPECT_EQ(pool_.usedBytes(), 0u);
}

}  // namespace
}  // namespace brickyard
