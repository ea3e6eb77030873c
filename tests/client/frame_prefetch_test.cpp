// The next frame of a sequence, fetched while another is drawn: less to wait for, and the same bits.
#include "client/frame_prefetch.h"

#include <gmock/gmock.h>

#include <cstring>

#include "blob_field.h"
#include "forwarding_source.h"
#include "stored_fields.h"

namespace brickyard {
namespace {

// Every third page comes damaged, each time.
class DamagingSource final : public ForwardingSource {
public:
    using ForwardingSource::ForwardingSource;
    Result<std::vector<Arrival>> take(SourceDeadline deadline) override {
        auto arrivals = inner_->take(deadline);
        if (arrivals)
            for (Arrival& arrival : *arrivals)
                if (!arrival.page.is_block && arrival.page.address.node % 3 == 0 && arrival.bytes)
                    (*arrival.bytes)[0] ^= std::byte(1);
        return arrivals;
    }
};

// A blob that moves two voxels from frame to frame.
FormulaField movedBlob(int frame) {
    return FormulaField("density", {{-30, -25, -20}, {35, 26, 37}},
                        [=](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                            return roughBlob(double(x - 2 * frame), double(y), double(z));
                        });
}

class FramePrefetchTest : public testing::Test {
protected:
    void SetUp() override {
        for (int frame = 0; frame < 3; ++frame) {
            const FormulaField field = movedBlob(frame);
            const Result<void> stored = storeFields(folder(), {&field}, 8, 0, std::uint32_t(frame));
            ASSERT_TRUE(stored) << stored.error().message;
        }
    }
    std::filesystem::path folder() const { return scratch_ / "moving.bricks"; }
    std::unique_ptr<BrickSource> open() const {
        auto source = openSource(folder().string(), "");
        EXPECT_TRUE(source) << source.error().message;
        return std::move(*source);
    }
    static RenderRequest request(std::uint32_t frame, bool reference = false) {
        RenderRequest request;
        request.frame = frame;
        request.width = 40, request.height = 32;
        request.camera = cameraAt({20, 20, 150}, {0, 0, 5});
        request.density_scale = 0.05;
        request.quality.max_error = 0.02;
        request.quality.reference = reference;
        for (const double d : {-1.0, -1.0, 0.3})
            (request.scene.lights().empty() ? request.scene.add_lights() : request.scene.mutable_lights(0))
                ->add_direction(d);
        return request;
    }
    struct Drawn {
        Picture picture;
        std::uint64_t bytes = 0;
        bool final = false;
    };
    Drawn draw(RenderRequest request, ResidentFrame* kept = nullptr) const {
        request.kept = kept;
        const auto source = open();
        auto outcome = makeCpuRenderer()->render(*source, request);
        EXPECT_TRUE(outcome) << outcome.error().message;
        return {std::move(outcome->picture), source->counters().bytes_streamed, outcome->final};
    }
    // Prefetches frame 1 after frame 0 was drawn, to the end.
    void prefetch(BrickSource& source, const RenderRequest& like, ResidentFrame& into,
                  std::uint64_t max_bytes = UINT64_MAX) const {
        ResidentFrame kept;
        draw(like, &kept);
        FramePrefetch ahead({&source, like.frame + 1, useOf(kept), like.cache_bytes, max_bytes,
                             [&](FrameFooter& footer) -> Result<void> {
                                 if (auto bound = bindScene(like.scene, footer); !bound)
                                     return tl::unexpected(bound.error());
                                 return {};
                             },
                             &into});
        while (!ahead.done()) std::this_thread::sleep_for(std::chrono::milliseconds(1));
        ahead.end();
    }
    static void expectSame(const Picture& a, const Picture& b) {
        ASSERT_EQ(a.pixels.size(), b.pixels.size());
        EXPECT_EQ(std::memcmp(a.pixels.data(), b.pixels.data(), a.pixels.size() * sizeof(Pixel)), 0);
    }

    ScratchFolder scratch_;
};

TEST_F(FramePrefetchTest, TheNextFrameIsMostlyThere) {
    for (const bool reference : {false, true}) {
        ResidentFrame next;
        const auto source = open();
        prefetch(*source, request(0, reference), next);
        const Drawn ahead = draw(request(1, reference), &next), alone = draw(request(1, reference));
        EXPECT_TRUE(ahead.final);
        EXPECT_LT(ahead.bytes, alone.bytes / 3) << "reference: " << reference;
        // And little comes that is not used.
        EXPECT_LT(source->counters().bytes_streamed, alone.bytes * 5 / 4);
        expectSame(ahead.picture, alone.picture);
    }
}

TEST_F(FramePrefetchTest, AnOffsetOfTheSceneIsPartOfWhatIsKept) {
    RenderRequest moved = request(0);
    for (const double offset : {0.5, 0.5, 0.5}) moved.scene.mutable_medium()->add_sample_offset(offset);
    ResidentFrame next;
    const auto source = open();
    prefetch(*source, moved, next);
    moved.frame = 1;
    const Drawn ahead = draw(moved, &next), alone = draw(moved);
    EXPECT_LT(ahead.bytes, alone.bytes / 3);
    expectSame(ahead.picture, alone.picture);
}

TEST_F(FramePrefetchTest, AFrameThatIsNotThereIsLeftToThePicture) {
    ResidentFrame next;
    const auto source = open();
    prefetch(*source, request(2), next);
    const auto again = open();
    RenderRequest absent = request(3);
    absent.kept = &next;
    const auto outcome = makeCpuRenderer()->render(*again, absent);
    ASSERT_FALSE(outcome);
    EXPECT_EQ(outcome.error().code, ErrorCode::kNotFound);
    EXPECT_THAT(outcome.error().message, testing::HasSubstr("3"));
}

TEST_F(FramePrefetchTest, DamagedPagesAreNotKept) {
    ResidentFrame next;
    DamagingSource source(open());
    prefetch(source, request(0), next);
    const Drawn ahead = draw(request(1), &next);
    EXPECT_TRUE(ahead.final);
    expectSame(ahead.picture, draw(request(1)).picture);
}

TEST_F(FramePrefetchTest, KeepsToItsBudgets) {
    const std::uint64_t page = 9 * 9 * 9 * 4 + 64;
    for (const std::uint64_t cache_bytes : {4 * page, 40 * page}) {
        RenderRequest tight = request(0);
        tight.cache_bytes = cache_bytes;
        ResidentFrame next;
        const auto source = open();
        prefetch(*source, tight, next);
        EXPECT_LE(next.cache().peakBytes(), cache_bytes);
        EXPECT_EQ(next.cache().counters().evictions, 0u);
        tight.frame = 1;
        expectSame(draw(tight, &next).picture, draw(request(1)).picture);
    }
    ResidentFrame next;
    const auto source = open();
    prefetch(*source, request(0), next, 5000);
    EXPECT_LE(source->counters().bytes_streamed, 5000u);
}

TEST_F(FramePrefetchTest, EndsWhenItIsToldTo) {
    ResidentFrame kept, next;
    draw(request(0), &kept);
    const auto source = open();
    for (int i = 0; i < 20; ++i) {
        FramePrefetch ahead({source.get(), 1, useOf(kept), request(1).cache_bytes, UINT64_MAX, {}, &next});
        if (i % 2) std::this_thread::sleep_for(std::chrono::microseconds(100 * i));
        ahead.end();
        ahead.end();
    }
    expectSame(draw(request(1), &next).picture, draw(request(1)).picture);
}

TEST_F(FramePrefetchTest, NothingDrawnIsNothingUsed) { EXPECT_TRUE(useOf(ResidentFrame()).channels.empty()); }

}  // namespace
}  // namespace brickyard
