// Bytes that change on the way, or on the server's disk: caught by checksum, asked for once more, reported
// once, and drawn from the parent with a bound that says so.
#include <gmock/gmock.h>

#include <cstring>
#include <functional>
#include <map>

#include "blob_field.h"
#include "client/renderer.h"
#include "forwarding_source.h"
#include "stored_fields.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

// Flips a byte of each page that `damages`, so many times.
class FlippingSource final : public ForwardingSource {
public:
    using Choice = std::function<bool(const WishedPage&)>;
    FlippingSource(std::unique_ptr<BrickSource> inner, Choice damages, int times)
        : ForwardingSource(std::move(inner)), damages_(std::move(damages)), times_(times) {}

    Result<std::vector<Arrival>> take(SourceDeadline deadline) override {
        Result<std::vector<Arrival>> some = inner_->take(deadline);
        if (!some) return some;
        for (Arrival& arrival : *some) {
            if (!arrival.bytes || !damages_(arrival.page)) continue;
            const PageAddress& address = arrival.page.address;
            int& done =
                done_[{arrival.page.is_block, address.draft, address.channel, address.block, address.node}];
            if (done++ >= times_) continue;
            (*arrival.bytes)[arrival.bytes->size() / 2] ^= std::byte{0x10};
        }
        return some;
    }
    int pagesDamaged() const { return int(done_.size()); }

private:
    Choice damages_;
    int times_;
    std::map<std::tuple<bool, bool, std::uint32_t, std::uint32_t, std::uint32_t>, int> done_;
};

class DamagedPagesTest : public testing::Test {
protected:
    void SetUp() override {
        const FormulaField field = roughBlobField();
        const Result<void> stored = storeFields(folder_ / "test.bricks", {&field});
        ASSERT_TRUE(stored) << stored.error().message;
    }
    static RenderRequest request() {
        RenderRequest request;
        request.width = 40, request.height = 32;
        request.camera = cameraAt({0, 20, 150}, {0, 0, 5});
        request.density_scale = 0.05;
        request.quality.max_error = 0.02;
        return request;
    }
    RenderOutcome draw(FlippingSource::Choice damages, int times,
                       const RenderRequest& request = DamagedPagesTest::request()) {
        FlippingSource source(std::move(*openSource((folder_ / "test.bricks").string(), "")),
                              std::move(damages), times);
        auto outcome = makeCpuRenderer()->render(source, request);
        EXPECT_TRUE(outcome) << outcome.error().message;
        damaged_ = source.pagesDamaged();
        return std::move(*outcome);
    }
    static bool never(const WishedPage&) { return false; }
    static bool isBrick(const WishedPage& page) { return !page.is_block; }
    static std::size_t differing(const Picture& a, const Picture& b) {
        std::size_t differ = 0;
        for (std::size_t i = 0; i < a.pixels.size(); ++i)
            differ += std::memcmp(&a.pixels[i], &b.pixels[i], sizeof(Pixel)) != 0;
        return differ;
    }
    // Each picture's bound holds the other one, which is within its own of the truth.
    static void expectHonest(const Picture& damaged, const Picture& sound) {
        for (std::size_t i = 0; i < damaged.pixels.size(); ++i) {
            const Pixel &a = damaged.pixels[i], &b = sound.pixels[i];
            ASSERT_LE(std::abs(a.alpha - b.alpha), a.bound_alpha + b.bound_alpha + 1e-6f) << "pixel " << i;
        }
    }

    ScratchFolder folder_;
    int damaged_ = 0;
};

TEST_F(DamagedPagesTest, APageThatIsSoundTheSecondTimeChangesNoBit) {
    const RenderOutcome sound = draw(never, 0);
    ASSERT_TRUE(sound.final);
    const RenderOutcome bricks = draw(isBrick, 1);
    EXPECT_GT(damaged_, 10);
    EXPECT_EQ(differing(bricks.picture, sound.picture), 0u);
    EXPECT_TRUE(bricks.final);
    EXPECT_EQ(bricks.not_final.failed, 0u);
    EXPECT_EQ(bricks.retried, std::uint64_t(damaged_));
    EXPECT_EQ(bricks.first_failure, "");
    const RenderOutcome blocks = draw([](const WishedPage& page) { return page.is_block; }, 1);
    EXPECT_GT(damaged_, 0);
    EXPECT_EQ(differing(blocks.picture, sound.picture), 0u);
    EXPECT_TRUE(blocks.final);
}

TEST_F(DamagedPagesTest, APageThatStaysDamagedIsDrawnFromItsParent) {
    const RenderOutcome sound = draw(never, 0);
    // Not the roots: there is nothing above them.
    const auto some = [](const WishedPage& page) { return !page.is_block && page.address.node % 7 == 3; };
    const RenderOutcome damaged = draw(some, 1000);
    EXPECT_GT(damaged_, 0);
    EXPECT_FALSE(damaged.final);
    EXPECT_EQ(damaged.not_final.failed, std::uint64_t(damaged_));
    EXPECT_GT(differing(damaged.picture, sound.picture), 0u);
    expectHonest(damaged.picture, sound.picture);
    // One report, that names where.
    EXPECT_THAT(damaged.first_failure, HasSubstr("test.bricks: frame 0: channel 'density': brick "));
    EXPECT_THAT(damaged.first_failure, HasSubstr("checksum"));
    EXPECT_EQ(damaged.first_failure.find('\n'), std::string::npos);
}

TEST_F(DamagedPagesTest, ALimitOfTimeDoesNotHideThem) {
    const RenderOutcome sound = draw(never, 0);
    RenderRequest limited = request();
    limited.deadline = std::chrono::duration<double>(30);
    const RenderOutcome damaged = draw(
        [](const WishedPage& page) { return !page.is_block && page.address.node % 7 == 3; }, 1000, limited);
    EXPECT_FALSE(damaged.final);
    EXPECT_GT(damaged.not_final.failed, 0u);
    expectHonest(damaged.picture, sound.picture);
}

TEST_F(DamagedPagesTest, ATreeThatStaysDamagedLeavesAPictureThatKnowsNothing) {
    const RenderOutcome damaged = draw([](const WishedPage& page) { return page.is_block; }, 1000);
    EXPECT_FALSE(damaged.final);
    EXPECT_GT(damaged.not_final.failed, 0u);
    EXPECT_THAT(damaged.first_failure, HasSubstr("frame 0: channel 'density': tree block 0"));
    const RenderOutcome sound = draw(never, 0);
    expectHonest(damaged.picture, sound.picture);
}

}  // namespace
}  // namespace brickyard
