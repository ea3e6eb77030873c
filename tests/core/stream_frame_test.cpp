#include "core/stream_frame.h"

#include <gmock/gmock.h>

#include <cstring>

namespace brickyard {
namespace {

using testing::HasSubstr;

std::vector<std::byte> bytesOf(std::initializer_list<int> values) {
    std::vector<std::byte> bytes;
    for (const int value : values) bytes.push_back(std::byte(value));
    return bytes;
}

std::vector<std::byte> pingMessage(std::uint64_t number, std::size_t payload_bytes = 0) {
    StreamHeader header;
    header.mutable_ping()->set_number(number);
    auto message = encodeStreamHead(header);
    message.resize(message.size() + payload_bytes, std::byte{0x5a});
    return message;
}

constexpr StreamFrameLimits kLimits{.header_bytes = 1000, .payload_bytes = 100};

TEST(StreamFrame, IsWrittenAsTheWorkedExampleOfTheProtocol) {
    // docs/protocol.md, section "Messages": Ping with number 300.
    EXPECT_EQ(pingMessage(300), bytesOf({0x05, 0, 0, 0, 0x2a, 0x03, 0x08, 0xac, 0x02}));
}

TEST(StreamFrame, GivesBackHeaderAndPayload) {
    const auto message = pingMessage(7, 100);
    const auto frame = parseStreamFrame(message, kLimits);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_EQ(frame->header.ping().number(), 7u);
    ASSERT_EQ(frame->payload.size(), 100u);
    EXPECT_EQ(frame->payload.front(), std::byte{0x5a});
}

// Each prefix is a vector of exactly its size, so that ASan sees a read past its end.
TEST(StreamFrame, RefusesEveryTruncationOfAHeader) {
    const auto whole = pingMessage(300);
    for (std::size_t size = 0; size < whole.size(); ++size) {
        const std::vector<std::byte> cut(whole.begin(), whole.begin() + std::ptrdiff_t(size));
        EXPECT_FALSE(parseStreamFrame(cut, kLimits)) << "accepted the first " << size << " bytes";
    }
}

TEST(StreamFrame, RefusesAHeaderLengthAboveTheLimitWithoutBelievingIt) {
    const auto claim = bytesOf({0xff, 0xff, 0xff, 0xff, 0x2a, 0x00});
    const auto frame = parseStreamFrame(claim, kLimits);
    ASSERT_FALSE(frame);
    EXPECT_THAT(frame.error().message, HasSubstr("4294967295"));
}

TEST(StreamFrame, RefusesAPayloadAboveTheLimit) {
    EXPECT_TRUE(parseStreamFrame(pingMessage(1, 100), kLimits));
    EXPECT_FALSE(parseStreamFrame(pingMessage(1, 101), kLimits));
}

TEST(StreamFrame, RefusesAHeaderThatIsNoMessage) {
    EXPECT_FALSE(parseStreamFrame(bytesOf({2, 0, 0, 0, 0xff, 0xff}), kLimits));
    // An empty header and one with only an unknown field say nothing either.
    EXPECT_FALSE(parseStreamFrame(bytesOf({0, 0, 0, 0}), kLimits));
    EXPECT_FALSE(parseStreamFrame(bytesOf({3, 0, 0, 0, 0xf8, 0x07, 0x01}), kLimits));
}

TEST(StreamFrame, SurvivesEveryFlippedBit) {
    StreamHeader header;
    Wish& wish = *header.mutable_wish();
    wish.set_epoch(3);
    for (std::uint32_t i = 0; i < 20; ++i) wish.add_pages()->set_node(i);
    const auto whole = encodeStreamHead(header);
    for (std::size_t bit = 0; bit < whole.size() * 8; ++bit) {
        auto flipped = whole;
        flipped[bit / 8] ^= std::byte(1 << bit % 8);
        // What is still a message must be one that can be written again.
        if (const auto frame = parseStreamFrame(flipped, kLimits))
            EXPECT_FALSE(encodeStreamHead(frame->header).empty());
    }
}

}  // namespace
}  // namespace brickyard
