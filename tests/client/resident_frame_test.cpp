// What is kept from picture to picture: it saves bytes and changes no bit. And pictures are the same in
// whatever order their pages come.
#include "client/resident_frame.h"

#include <gmock/gmock.h>

#include <cstring>
#include <numbers>

#include "blob_field.h"
#include "client/renderer.h"
#include "shuffled_source.h"
#include "stored_fields.h"

namespace brickyard {
namespace {

class ResidentFrameTest : public testing::Test {
protected:
    void SetUp() override {
        const FormulaField field = roughBlobField();
        const Result<void> stored = storeFields(folder_ / "test.bricks", {&field});
        ASSERT_TRUE(stored) << stored.error().message;
        reopen();
    }
    void reopen() {
        auto source = openSource((folder_ / "test.bricks").string(), "");
        ASSERT_TRUE(source) << source.error().message;
        source_ = std::move(*source);
    }
    static RenderRequest request(double angle = 0, double distance = 150) {
        RenderRequest request;
        request.width = 40, request.height = 32;
        request.camera =
            cameraAt({distance * std::sin(angle), 20, 5 + distance * std::cos(angle)}, {0, 0, 5});
        request.density_scale = 0.05;
        request.quality.max_error = 0.02;
        return request;
    }
    static RenderRequest lit(RenderRequest request) {
        Light* light = request.scene.add_lights();
        for (const double d : {-1.0, -1.0, 0.3}) light->add_direction(d);
        return request;
    }
    RenderOutcome draw(const RenderRequest& request) {
        const std::uint64_t before = source_->counters().bytes_streamed;
        auto outcome = makeCpuRenderer()->render(*source_, request);
        EXPECT_TRUE(outcome) << outcome.error().message;
        streamed_ = source_->counters().bytes_streamed - before;
        return std::move(*outcome);
    }
    RenderOutcome drawKept(RenderRequest request) {
        request.kept = &kept_;
        return draw(request);
    }
    static std::size_t differing(const Picture& a, const Picture& b) {
        std::size_t differ = a.pixels.size() == b.pixels.size() ? 0 : a.pixels.size();
        for (std::size_t i = 0; i < std::min(a.pixels.size(), b.pixels.size()); ++i)
            differ += std::memcmp(&a.pixels[i], &b.pixels[i], sizeof(Pixel)) != 0;
        return differ;
    }

    ScratchFolder folder_;
    std::unique_ptr<BrickSource> source_;
    ResidentFrame kept_;
    std::uint64_t streamed_ = 0;  // bytes, by the last picture
};

TEST_F(ResidentFrameTest, TheSameViewAgainStreamsNothing) {
    const RenderOutcome first = drawKept(request());
    EXPECT_GT(streamed_, 0u);
    EXPECT_EQ(first.cache.hits, 0u);
    EXPECT_GT(first.cache.loads, 0u);
    const RenderOutcome again = drawKept(request());
    EXPECT_EQ(streamed_, 0u);
    EXPECT_TRUE(again.final);
    EXPECT_EQ(again.passes, 1u);
    EXPECT_GT(again.cache.hits, 0u);
    EXPECT_EQ(again.cache.loads, 0u);
    EXPECT_EQ(again.cache.hitRate(), 1.0);
    EXPECT_EQ(differing(first.picture, again.picture), 0u);
}

TEST_F(ResidentFrameTest, AnotherViewStreamsOnlyWhatIsNew) {
    drawKept(request());
    const RenderOutcome turned = drawKept(request(0.2));
    const std::uint64_t with = streamed_;
    const RenderOutcome fresh = draw(request(0.2));
    EXPECT_LT(with, streamed_ / 2) << "an orbit's next view sees mostly the same";
    EXPECT_GT(turned.cache.hitRate(), 0.5);
    EXPECT_EQ(differing(fresh.picture, turned.picture), 0u);
}

// A whole brick that is there does not stand in for the draft that the picture asks for: its bits would be
// others.
TEST_F(ResidentFrameTest, WhatOtherQualitiesAndLightsLeftBehindChangesNoBit) {
    RenderRequest reference = request();
    reference.quality = {.reference = true};
    RenderRequest strict = request(0.4);
    strict.quality = {.strict = true, .max_error = 0.1};
    RenderRequest loose = request();
    loose.quality.max_error = 0.2;
    std::vector<RenderRequest> requests;
    for (const RenderRequest& r : {reference, loose, strict, request()})
        requests.push_back(r), requests.push_back(lit(r));
    for (const std::uint64_t cache_bytes : {std::uint64_t(1) << 30, std::uint64_t(100) << 10}) {
        for (std::size_t i = 0; i < requests.size(); ++i) {
            RenderRequest kept = requests[i];
            kept.cache_bytes = cache_bytes;
            const RenderOutcome outcome = drawKept(kept);
            EXPECT_TRUE(outcome.final);
            EXPECT_EQ(differing(draw(requests[i]).picture, outcome.picture), 0u)
                << "request " << i << " with a cache of " << cache_bytes;
        }
    }
}

TEST_F(ResidentFrameTest, ATightBudgetOverManyViewsIsNeverExceeded) {
    constexpr int kViews = 24;
    RenderRequest tight = request();
    tight.cache_bytes = draw(request()).cache_bytes / 3;
    std::uint64_t reloads = 0, hits = 0;
    for (int i = 0; i < kViews; ++i) {
        // Round, and at its middle through the blob.
        const double angle = 2 * std::numbers::pi * i / kViews;
        RenderRequest view = request(angle, 100 + 90 * std::cos(angle));
        view.cache_bytes = tight.cache_bytes;
        const RenderOutcome outcome = drawKept(view);
        ASSERT_TRUE(outcome.final) << "view " << i;
        ASSERT_LE(outcome.cache_bytes, tight.cache_bytes) << "view " << i;
        ASSERT_LE(kept_.cache().size() * kept_.cache().pageBytes(), tight.cache_bytes);
        reloads += outcome.cache.reloads, hits += outcome.cache.hits;
        view.cache_bytes = std::uint64_t(1) << 30;
        EXPECT_EQ(differing(draw(view).picture, outcome.picture), 0u) << "view " << i;
    }
    EXPECT_GT(reloads, 0u) << "the budget was not tight";
    EXPECT_GT(hits, 0u);
}

TEST_F(ResidentFrameTest, BeginsEmptyForAnotherFrameOrBudget) {
    const RenderOutcome first = drawKept(request());
    RenderRequest other = request();
    other.cache_bytes /= 2;
    EXPECT_EQ(drawKept(other).cache.hits, 0u) << "another budget";

    const FormulaField field = roughBlobField({{-30, -25, -20}, {25, 26, 37}});
    ASSERT_TRUE(storeFields(folder_ / "test.bricks", {&field}));
    reopen();
    const RenderOutcome changed = drawKept(other);
    EXPECT_EQ(changed.cache.hits, 0u) << "another frame of the same number";
    EXPECT_EQ(differing(draw(request()).picture, changed.picture), 0u);
    EXPECT_GT(differing(first.picture, changed.picture), 0u);
}

// One frame is one frame, whichever source it comes from.
TEST_F(ResidentFrameTest, OutlivesItsSource) {
    drawKept(request());
    reopen();
    drawKept(request());
    EXPECT_EQ(streamed_, 0u);
}

TEST_F(ResidentFrameTest, APictureIsTheSameWhateverOrderItsPagesComeIn) {
    unsigned seed = 0;
    std::uint64_t reloads = 0, held_back = 0;
    for (const RenderRequest& asked : {request(), request(4.45, 76), lit(request())}) {
        reopen();
        const RenderOutcome whole = draw(asked);
        ASSERT_TRUE(whole.final);
        for (const unsigned threads : {1u, 2u, 3u})
            for (const std::uint64_t share : {1u, 10u}) {
                reopen();
                ShuffledSource shuffled(std::move(source_), ++seed);
                RenderRequest again = asked;
                again.threads = threads;
                again.cache_bytes = whole.cache_bytes / share;
                const auto outcome = makeCpuRenderer()->render(shuffled, again);
                ASSERT_TRUE(outcome) << outcome.error().message;
                EXPECT_TRUE(outcome->final) << threads << " threads, a cache of 1/" << share;
                EXPECT_LE(outcome->cache_bytes, again.cache_bytes);
                EXPECT_EQ(differing(whole.picture, outcome->picture), 0u)
                    << threads << " threads, a cache of 1/" << share << ", seed " << seed;
                reloads += outcome->cache.reloads, held_back += shuffled.heldBack();
            }
    }
    EXPECT_GT(reloads, 0u) << "the caches were not tight";
    EXPECT_GT(held_back, 0u);
}

}  // namespace
}  // namespace brickyard
