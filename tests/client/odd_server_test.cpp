// Servers that are old, fall silent, or say what they should not.
#include <gmock/gmock.h>

#include <mutex>

#include "client/remote_source.h"
#include "scripted_server.h"

namespace brickyard {
namespace {

using testing::HasSubstr;
using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

// Frames 7 and 8 of one channel; every page is a failure, so that no payload is needed.
bool answer(const StreamHeader& asked, std::vector<StreamHeader>& answers, std::uint32_t minor) {
    switch (asked.message_case()) {
        case StreamHeader::kHello: return true;
        case StreamHeader::kOpen: {
            Welcome& welcome = *answers.emplace_back().mutable_welcome();
            welcome.set_protocol_major(kProtocolMajor);
            welcome.set_protocol_minor(minor);
            welcome.set_dataset_id(1);
            for (const std::uint32_t frame : {7u, 8u})
                welcome.mutable_manifest()->add_frames()->set_frame(frame);
            return true;
        }
        case StreamHeader::kOpenFrame: {
            const OpenFrame& open = asked.open_frame();
            const std::uint32_t frame = minor > 0 && open.first_frame() ? 7 : open.frame();
            if (frame != 7 && frame != 8) {
                Failed& failed = *answers.emplace_back().mutable_failed();
                failed.set_reason(Failed::REASON_NO_FRAME);
                failed.set_message("no such frame");
                failed.set_frame(frame);
                return true;
            }
            FrameOpened& opened = *answers.emplace_back().mutable_frame_opened();
            opened.set_dataset_id(1);
            opened.set_frame(frame);
            ChannelFooter& channel = *opened.mutable_footer()->add_channels();
            channel.set_name("density");
            channel.set_components(1);
            return true;
        }
        case StreamHeader::kWish: {
            const Wish& wish = asked.wish();
            if (minor == 0 && wish.has_camera() && wish.camera().camera().eye_size() != 3) {
                Failed& failed = *answers.emplace_back().mutable_failed();
                failed.set_reason(Failed::REASON_PROTOCOL);
                failed.set_message("camera: eye has 0 numbers; give three");
                return false;
            }
            for (const PageRef& page : wish.pages()) {
                Failed& failed = *answers.emplace_back().mutable_failed();
                failed.set_reason(Failed::REASON_NO_PAGE);
                failed.set_epoch(wish.epoch());
                failed.set_frame(wish.frame());
                *failed.mutable_page() = page;
            }
            answers.emplace_back().mutable_wish_done()->set_epoch(wish.epoch());
            return true;
        }
        default: return true;
    }
}

StreamAddress addressOf(const ScriptedServer& server) {
    StreamAddress address;
    address.host = "127.0.0.1";
    address.port = server.port();
    address.dataset = "plume";
    return address;
}

StartHint hint() {
    StartHint hint{std::nullopt, StartView()};
    hint.view->width = hint.view->height = 64;
    hint.view->channels = {"density"};
    hint.view->credit_bytes = 1u << 20;
    return hint;
}

PageWish onePage() {
    PageWish wish;
    wish.credit_bytes = 1u << 20;
    wish.pages.push_back({false, {0, 0, 0}});
    return wish;
}

// Says nothing more from a message of this kind on.
ScriptedServer::Script silentFrom(StreamHeader::MessageCase kind) {
    return [kind, silent = false](const StreamHeader& asked, std::vector<StreamHeader>& answers) mutable {
        silent = silent || asked.message_case() == kind;
        return silent || answer(asked, answers, kProtocolMinor);
    };
}

TEST(OddServer, OneThatIsOlderThanHintsIsAskedWithoutThem) {
    const ScriptedServer old([](const StreamHeader& asked, std::vector<StreamHeader>& answers) {
        return answer(asked, answers, /*minor=*/0);
    });
    const auto source = RemoteSource::open(addressOf(old), "", {}, hint());
    ASSERT_TRUE(source) << source.error().message;
    const auto footer = (*source)->openFrame(7, Clock::now() + std::chrono::seconds(20));
    ASSERT_TRUE(footer) << footer.error().message;
    EXPECT_EQ(footer->channels(0).name(), "density");
    ASSERT_TRUE((*source)->wish(onePage()));
    const auto arrivals = (*source)->take(Clock::now() + std::chrono::seconds(20));
    ASSERT_TRUE(arrivals && arrivals->size() == 1);
    EXPECT_TRUE((*source)->openFrame(8));
}

TEST(OddServer, EveryWaitEndsByItsDeadlineAndNamesWhatItWasFor) {
    const ScriptedServer no_frames(silentFrom(StreamHeader::kOpenFrame));
    {
        const auto source = std::move(*RemoteSource::open(addressOf(no_frames), ""));
        const auto begin = Clock::now();
        const auto footer = source->openFrame(8, begin + milliseconds(100));
        ASSERT_FALSE(footer);
        EXPECT_LT(Clock::now() - begin, std::chrono::seconds(3));
        EXPECT_EQ(footer.error().code, ErrorCode::kTimeout);
        EXPECT_THAT(footer.error().message, HasSubstr("/plume: waited for frame 8"));
        const auto change = source->waitForChange(Clock::now() + milliseconds(50));
        EXPECT_TRUE(change && !*change);
    }
    const ScriptedServer no_pages(silentFrom(StreamHeader::kWish));
    const auto source = std::move(*RemoteSource::open(addressOf(no_pages), ""));
    ASSERT_TRUE(source->openFrame(8));
    ASSERT_TRUE(source->wish(onePage()));
    const auto begin = Clock::now();
    const auto arrivals = source->take(begin + milliseconds(100));
    EXPECT_LT(Clock::now() - begin, std::chrono::seconds(3));
    EXPECT_TRUE(arrivals && arrivals->empty());
    EXPECT_FALSE(source->wishDone());
}

TEST(OddServer, ASilentOneIsGivenUpWithoutADeadlineToo) {
    StreamTimeouts timeouts;
    timeouts.idle = milliseconds(300);
    timeouts.connect = milliseconds(500);
    const ScriptedServer no_welcome(silentFrom(StreamHeader::kOpen));
    const auto unopened = RemoteSource::open(addressOf(no_welcome), "", timeouts);
    ASSERT_FALSE(unopened);
    EXPECT_EQ(unopened.error().code, ErrorCode::kTimeout);
    EXPECT_THAT(unopened.error().message, HasSubstr("waited for dataset plume"));

    const ScriptedServer no_frames(silentFrom(StreamHeader::kOpenFrame));
    {
        const auto source = std::move(*RemoteSource::open(addressOf(no_frames), "", timeouts));
        const auto footer = source->openFrame(7);
        ASSERT_FALSE(footer);
        EXPECT_EQ(footer.error().code, ErrorCode::kTimeout);
        EXPECT_THAT(footer.error().message, HasSubstr("waited for frame 7"));
    }
    const ScriptedServer no_pages(silentFrom(StreamHeader::kWish));
    const auto source = std::move(*RemoteSource::open(addressOf(no_pages), "", timeouts));
    ASSERT_TRUE(source->openFrame(7));
    ASSERT_TRUE(source->wish(onePage()));
    const auto arrivals = source->take(SourceDeadline::max());
    ASSERT_FALSE(arrivals);
    EXPECT_EQ(arrivals.error().code, ErrorCode::kTimeout);
    EXPECT_THAT(arrivals.error().message, HasSubstr("waited for pages"));
}

TEST(OddServer, OneThatIsLostAgainAndAgainUsesUpItsPatienceOnce) {
    // It greets, and closes where a frame is wanted.
    const ScriptedServer fragile([](const StreamHeader& asked, std::vector<StreamHeader>& answers) {
        if (asked.has_open_frame()) return false;
        return answer(asked, answers, kProtocolMinor);
    });
    StreamTimeouts timeouts;
    timeouts.reconnect = milliseconds(700);
    const auto source = std::move(*RemoteSource::open(addressOf(fragile), "", timeouts));
    const auto begin = Clock::now();
    const auto footer = source->openFrame(7);
    ASSERT_FALSE(footer);
    EXPECT_EQ(footer.error().code, ErrorCode::kTimeout);
    EXPECT_LT(Clock::now() - begin, std::chrono::seconds(10));
}

TEST(OddServer, WhatWasNotAskedForEndsTheConnection) {
    const ScriptedServer chatty([](const StreamHeader& asked, std::vector<StreamHeader>& answers) {
        if (!asked.has_wish()) return answer(asked, answers, kProtocolMinor);
        answers.emplace_back().mutable_frame_opened()->set_frame(7);
        return true;
    });
    const auto source = std::move(*RemoteSource::open(addressOf(chatty), ""));
    ASSERT_TRUE(source->openFrame(7));
    ASSERT_TRUE(source->wish(onePage()));
    const auto arrivals = source->take(Clock::now() + std::chrono::seconds(20));
    ASSERT_FALSE(arrivals);
    EXPECT_EQ(arrivals.error().code, ErrorCode::kCorrupt);
}

}  // namespace
}  // namespace brickyard
