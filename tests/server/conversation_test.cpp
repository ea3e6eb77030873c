// The conversation without a socket: order, limits, replacement.
#include "server/conversation.h"

#include <gmock/gmock.h>

#include "core/stream_frame.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

class ConversationTest : public testing::Test {
protected:
    void SetUp() override {
        auto catalog = Catalog::open({tiny_.folder()}, 8, 1u << 20);
        ASSERT_TRUE(catalog) << catalog.error().message;
        catalog_ = std::move(*catalog);
        restart();
    }
    void restart() {
        ConversationServices services;
        services.catalog = catalog_.get();
        services.tokens = [this] { return tokens_; };
        talk_ = std::make_unique<Conversation>(services);
    }

    void say(const StreamHeader& header) { talk_->receive(encodeStreamHead(header)); }
    void sayHello(std::uint32_t major = kProtocolMajor, const std::string& token = "") {
        StreamHeader header;
        header.mutable_hello()->set_protocol_major(major);
        header.mutable_hello()->set_token(token);
        say(header);
    }
    void sayOpen(const std::string& name) {
        StreamHeader header;
        header.mutable_open()->set_dataset(name);
        say(header);
    }
    // Past Welcome.
    void establish() {
        sayHello();
        sayOpen("tiny");
        ASSERT_TRUE(answer().has_welcome());
    }
    Wish wishFor(std::uint64_t epoch, std::size_t pages, std::uint64_t credit = 1u << 20) {
        Wish wish;
        wish.set_epoch(epoch);
        wish.set_dataset_id(1);
        wish.set_frame(30);
        wish.set_credit_bytes(credit);
        const auto bricks = tiny_.bricks(0);
        for (std::size_t i = 0; i < pages; ++i) {
            PageRef& ref = *wish.add_pages();
            ref.set_block(bricks[i % bricks.size()].block);
            ref.set_node(bricks[i % bricks.size()].node);
        }
        return wish;
    }
    void sayWish(const Wish& wish) {
        StreamHeader header;
        *header.mutable_wish() = wish;
        say(header);
    }
    // The next message's header; empty where there is none.
    StreamHeader answer() {
        const auto message = next();
        if (message.empty()) return {};
        const auto frame = parseStreamFrame(message, {kMaxServerHeaderBytes, kBatchBytes});
        EXPECT_TRUE(frame);
        return frame->header;
    }
    // The next message, out of its WebSocket frame; empty where there is none.
    std::vector<std::byte> next() {
        OutBatch batch(pool_.take());
        talk_->fill(batch, ReadMode::kMayBlock, [&] { return batch.messageCount() == 1; });
        if (batch.empty()) return {};
        const std::size_t length = std::to_integer<std::size_t>(batch.data()[1]);
        const std::size_t frame_head = length < 126 ? 2 : length == 126 ? 4 : 10;
        return {batch.data() + frame_head, batch.data() + batch.size()};
    }
    void expectRefusal(Failed::Reason reason) {
        EXPECT_EQ(answer().failed().reason(), reason);
        EXPECT_TRUE(talk_->over());
        EXPECT_TRUE(next().empty());
    }

    TinyDataset tiny_;
    std::shared_ptr<const AccessTokens> tokens_;
    BatchPool pool_{1u << 20};
    std::unique_ptr<Catalog> catalog_;
    std::unique_ptr<Conversation> talk_;
};

TEST_F(ConversationTest, WelcomesAClientThatSaysHelloAndOpens) {
    sayHello();
    EXPECT_TRUE(next().empty()) << "Hello alone has no answer";
    EXPECT_FALSE(talk_->established());
    sayOpen("tiny");
    const auto welcome = answer();
    EXPECT_EQ(welcome.welcome().dataset_id(), 1u);
    EXPECT_EQ(welcome.welcome().manifest().frames_size(), 1);
    EXPECT_TRUE(talk_->established());
}

TEST_F(ConversationTest, RefusesAnyFirstMessageButHello) {
    sayOpen("tiny");
    expectRefusal(Failed::REASON_PROTOCOL);
}

TEST_F(ConversationTest, RefusesAnotherProtocolVersion) {
    sayHello(2);
    expectRefusal(Failed::REASON_VERSION);
}

TEST_F(ConversationTest, RefusesAWrongToken) {
    tokens_ = std::make_shared<const AccessTokens>("secret");
    for (const char* wrong : {"", "secre", "secrets", "Secret", "ecretsecret"}) {
        restart();
        sayHello(1, wrong);
        expectRefusal(Failed::REASON_TOKEN);
    }
    restart();
    sayHello(1, "secret");
    EXPECT_FALSE(talk_->over());
}

TEST_F(ConversationTest, NamesTheDatasetsWhereOneIsUnknownAndGoesOn) {
    sayHello();
    sayOpen("plume");
    const auto failed = answer();
    EXPECT_EQ(failed.failed().reason(), Failed::REASON_NO_DATASET);
    EXPECT_THAT(failed.failed().message(), HasSubstr("tiny"));
    sayOpen("tiny");
    EXPECT_TRUE(answer().has_welcome());
}

TEST_F(ConversationTest, OpensAFrameAndSaysWhichThereAre) {
    establish();
    StreamHeader header;
    header.mutable_open_frame()->set_dataset_id(1);
    header.mutable_open_frame()->set_frame(30);
    say(header);
    EXPECT_EQ(answer().frame_opened().footer().channels_size(), 2);
    header.mutable_open_frame()->set_frame(31);
    say(header);
    const auto failed = answer();
    EXPECT_EQ(failed.failed().reason(), Failed::REASON_NO_FRAME);
    EXPECT_THAT(failed.failed().message(), HasSubstr("30"));
    header.mutable_open_frame()->set_dataset_id(2);
    say(header);
    expectRefusal(Failed::REASON_PROTOCOL);
}

TEST_F(ConversationTest, ANewWishReplacesTheOlderOne) {
    establish();
    sayWish(wishFor(1, 10));
    EXPECT_EQ(answer().page().epoch(), 1u);
    EXPECT_EQ(answer().page().epoch(), 1u);
    sayWish(wishFor(2, 1));
    EXPECT_EQ(answer().page().epoch(), 2u);
    const auto done = answer();
    EXPECT_EQ(done.wish_done().epoch(), 2u);
    EXPECT_EQ(done.wish_done().sent_bytes(), 96u);
    EXPECT_TRUE(next().empty()) << "something of the older wish is still owed";
}

TEST_F(ConversationTest, IgnoresAWishThatIsNotNewer) {
    establish();
    sayWish(wishFor(5, 2));
    sayWish(wishFor(5, 1));
    sayWish(wishFor(4, 1));
    EXPECT_EQ(answer().page().epoch(), 5u);
    EXPECT_EQ(answer().page().epoch(), 5u);
    EXPECT_EQ(answer().wish_done().sent_bytes(), 192u);
}

TEST_F(ConversationTest, KeepsTheCredit) {
    establish();
    sayWish(wishFor(1, 10, 200));
    EXPECT_TRUE(answer().has_page());
    EXPECT_TRUE(answer().has_page());
    const auto done = answer();
    EXPECT_TRUE(done.wish_done().credit_exhausted());
    EXPECT_EQ(done.wish_done().sent_bytes(), 192u);
}

TEST_F(ConversationTest, AnswersPingsBetweenPages) {
    establish();
    sayWish(wishFor(1, 10));
    EXPECT_TRUE(answer().has_page());
    StreamHeader ping;
    ping.mutable_ping()->set_number(99);
    say(ping);
    EXPECT_EQ(answer().pong().number(), 99u);
    EXPECT_TRUE(answer().has_page());
}

TEST_F(ConversationTest, AWishForAFrameThatIsGoneEndsTheOlderOneToo) {
    establish();
    sayWish(wishFor(1, 10));
    Wish wish = wishFor(2, 1);
    wish.set_frame(31);
    sayWish(wish);
    const auto failed = answer();
    EXPECT_EQ(failed.failed().reason(), Failed::REASON_NO_FRAME);
    EXPECT_EQ(failed.failed().epoch(), 2u);
    EXPECT_TRUE(next().empty());
    EXPECT_FALSE(talk_->over());
}

TEST_F(ConversationTest, TakesAWishAtEachLimitAndRefusesOneAbove) {
    const auto with = [&](auto change, int over) {
        restart();
        establish();
        Wish wish = wishFor(1, 0);
        change(wish, over);
        sayWish(wish);
        if (over == 0)
            EXPECT_FALSE(talk_->over());
        else
            expectRefusal(Failed::REASON_PROTOCOL);
    };
    const auto pages = [](Wish& wish, int over) {
        for (int i = 0; i < kMaxWishPages + over; ++i) wish.add_pages();
    };
    const auto blocks = [](Wish& wish, int over) {
        for (int i = 0; i < kMaxWishBlocks + over; ++i) wish.add_blocks();
    };
    const auto camera = [](Wish& wish) -> CameraWish& {
        CameraWish& seen = *wish.mutable_camera();
        for (const double x : {0.0, 0.0, 50.0}) seen.mutable_camera()->add_eye(x);
        for (const double x : {0.0, 0.0, 0.0}) seen.mutable_camera()->add_target(x);
        seen.set_width(64);
        seen.set_height(64);
        return seen;
    };
    const auto width = [&](Wish& wish, int over) {
        camera(wish).set_width(kMaxPictureEdge + std::uint32_t(over));
    };
    const auto height = [&](Wish& wish, int over) { camera(wish).set_height(over ? 0 : 1); };
    const auto channels = [&](Wish& wish, int over) {
        CameraWish& seen = camera(wish);
        for (int i = 0; i < kMaxWishChannels + over; ++i) seen.add_channels(1);
    };
    const auto eye = [&](Wish& wish, int over) { camera(wish).mutable_camera()->set_eye(2, over ? 0 : 1); };
    const auto channel = [&](Wish& wish, int over) { camera(wish).add_channels(over ? 2 : 1); };
    for (const int over : {0, 1}) {
        with(pages, over);
        with(blocks, over);
        with(width, over);
        with(height, over);
        with(channels, over);
        with(eye, over);
        with(channel, over);
    }
}

TEST_F(ConversationTest, RefusesMalformedMessages) {
    const auto refuses = [&](std::vector<std::byte> message) {
        restart();
        establish();
        talk_->receive(message);
        expectRefusal(Failed::REASON_PROTOCOL);
    };
    refuses({});
    refuses({std::byte{1}});
    refuses(std::vector<std::byte>(4, std::byte{0xff}));
    refuses(std::vector<std::byte>(kMaxClientMessageBytes + 1));
    StreamHeader header;
    header.mutable_pong();
    refuses(encodeStreamHead(header));
    header.mutable_ping();
    auto with_payload = encodeStreamHead(header);
    with_payload.push_back(std::byte{0});
    refuses(with_payload);
    header.mutable_hello()->set_protocol_major(1);
    refuses(encodeStreamHead(header));
}

TEST_F(ConversationTest, OpensAtMostSixteenDatasetsButOneAsOftenAsAsked) {
    establish();
    for (int i = 0; i < 20; ++i) {
        sayOpen("tiny");
        EXPECT_EQ(answer().welcome().dataset_id(), 1u);
    }
    EXPECT_FALSE(talk_->over());
}

TEST_F(ConversationTest, AsksToPauseWhileAnswersWait) {
    establish();
    StreamHeader ping;
    ping.mutable_ping();
    while (!talk_->backlogged()) say(ping);
    EXPECT_TRUE(answer().has_pong());
    EXPECT_FALSE(talk_->backlogged());
}

}  // namespace
}  // namespace brickyard
