// Batches of WebSocket frames: what is added can be read back, whatever is taken out between.
#include "server/out_batch.h"

#include <gmock/gmock.h>

#include <random>

namespace brickyard {
namespace {

struct Sent {
    std::vector<std::byte> message;
    std::size_t end = 0;
    bool is_page = false;
};

// The frames' messages, as RFC 6455 tells to read them.
std::vector<std::vector<std::byte>> messagesOf(const OutBatch& batch) {
    std::vector<std::vector<std::byte>> messages;
    std::span<const std::byte> bytes(batch.data(), batch.size());
    while (!bytes.empty()) {
        EXPECT_EQ(bytes[0], std::byte{0x82}) << "final, binary";
        std::size_t length = std::to_integer<std::size_t>(bytes[1]), at = 2;
        EXPECT_LT(length, 128u) << "a server does not mask";
        const std::size_t digits = length < 126 ? 0 : length == 126 ? 2 : 8;
        if (digits > 0) length = 0;
        for (std::size_t i = 0; i < digits; ++i)
            length = length << 8 | std::to_integer<std::size_t>(bytes[at++]);
        // The shortest way to write it is the only one allowed.
        EXPECT_EQ(digits, length < 126 ? 0u : length < 65536 ? 2u : 8u);
        messages.emplace_back(bytes.begin() + std::ptrdiff_t(at),
                              bytes.begin() + std::ptrdiff_t(at + length));
        bytes = bytes.subspan(at + length);
    }
    return messages;
}

std::vector<std::byte> bytesOf(std::size_t count, std::uint32_t seed) {
    std::vector<std::byte> bytes(count);
    for (std::byte& byte : bytes) byte = std::byte((seed = seed * 1664525 + 1013904223) >> 24);
    return bytes;
}

class OutBatchTest : public testing::Test {
protected:
    void add(std::size_t head_bytes, std::size_t payload_bytes, bool is_page) {
        auto message = bytesOf(head_bytes + payload_bytes, ++seed_);
        const auto payload = batch_.add(std::span(message).first(head_bytes), payload_bytes, is_page);
        ASSERT_EQ(payload.size(), payload_bytes);
        std::copy(message.begin() + std::ptrdiff_t(head_bytes), message.end(), payload.begin());
        sent_.push_back({std::move(message), batch_.size(), is_page});
    }
    void expectWhatWasSent() {
        const auto messages = messagesOf(batch_);
        ASSERT_EQ(messages.size(), sent_.size());
        ASSERT_EQ(batch_.messageCount(), sent_.size());
        for (std::size_t i = 0; i < sent_.size(); ++i) ASSERT_EQ(messages[i], sent_[i].message) << i;
        ASSERT_EQ(batch_.size(), sent_.empty() ? 0 : sent_.back().end);
    }

    BatchPool pool_{4 * kBatchBytes};
    OutBatch batch_{pool_.take()};
    std::vector<Sent> sent_;
    std::uint32_t seed_ = 0;
};

TEST_F(OutBatchTest, WritesLengthsOfAllThreeKinds) {
    for (const std::size_t bytes : {0u, 1u, 125u, 126u, 127u, 255u, 256u})
        add(bytes / 2, bytes - bytes / 2, false);
    add(100, 65535 - 100, true);
    expectWhatWasSent();
    batch_ = OutBatch(pool_.take());
    sent_.clear();
    add(100, 65536 - 100, true);
    expectWhatWasSent();
}

TEST_F(OutBatchTest, IsFullToItsLastByte) {
    EXPECT_FALSE(batch_.fits(kBatchBytes - 9));
    ASSERT_TRUE(batch_.fits(kBatchBytes - 10));
    add(4, kBatchBytes - 14, true);
    EXPECT_EQ(batch_.size(), kBatchBytes);
    EXPECT_FALSE(batch_.fits(0));
    expectWhatWasSent();
}

TEST_F(OutBatchTest, TellsWhereAMessageEnds) {
    add(10, 0, false);
    add(4, 200, true);
    EXPECT_EQ(batch_.messageEnd(0), 0u);
    EXPECT_EQ(batch_.messageEnd(1), 12u);
    EXPECT_EQ(batch_.messageEnd(12), 12u);
    EXPECT_EQ(batch_.messageEnd(13), batch_.size());
    EXPECT_EQ(batch_.messageEnd(batch_.size()), batch_.size());
}

// Against a model, as a connection uses it: answers, pages behind them, cuts at where a write stands.
TEST_F(OutBatchTest, DropsOnlyWhatHasNotBegun) {
    std::mt19937 dice(1);
    const auto below = [&](std::size_t n) { return std::size_t(dice() % n); };
    for (int round = 0; round < 3000; ++round) {
        batch_ = {};
        batch_ = OutBatch(pool_.take());
        sent_.clear();
        const std::size_t answers = below(3), pages = below(8);
        for (std::size_t i = 0; i < answers; ++i) add(4 + below(300), 0, false);
        for (std::size_t i = 0; i < pages; ++i)
            add(4 + below(60), below(4) == 0 ? below(9000) : below(300), true);
        if (pages > 0 && below(8) == 0) {
            batch_.removeLast();
            sent_.pop_back();
        }
        const std::size_t at = below(batch_.size() + 1);
        const std::size_t committed = batch_.messageEnd(at);
        std::size_t begin = 0, expected = at;
        for (const Sent& sent : sent_) {
            if (begin < at && at < sent.end) expected = sent.end;
            begin = sent.end;
        }
        ASSERT_EQ(committed, expected);
        const bool all = below(2) == 0;
        if (all)
            batch_.dropAll(committed);
        else
            batch_.dropPages(committed);
        while (!sent_.empty() && (sent_.size() > 1 ? sent_[sent_.size() - 2].end : 0) >= committed &&
               (all || sent_.back().is_page))
            sent_.pop_back();
        ASSERT_NO_FATAL_FAILURE(expectWhatWasSent());
    }
}

}  // namespace
}  // namespace brickyard
