// No medium is anywhere thicker than its majorants say, nor glows where they say it does not.
#include <cmath>
#include <random>

#include "blob_field.h"
#include "client/trace/medium_reader.h"
#include "client/trace/traced_world.h"
#include "streamed_frame.h"

namespace brickyard {
namespace {

using Position = std::int64_t;

double puff(double x, double y, double z) {
    const double r = std::sqrt(x * x + y * y + z * z) / 11;
    return std::max(0.0, 1 - r) * (0.6 + 0.4 * std::sin(1.7 * x + y * z)) + (r < 0.3 ? 2 : 0);
}

class MajorantTest : public testing::Test {
protected:
    // Density, glow and velocity of a moment; the puff has moved on, and so may have the lattice.
    void store(std::uint32_t number, const glm::dvec3& moved, const glm::dvec3& velocity,
               Position lattice_shift = 0, double scale = 1) {
        const double s = double(lattice_shift);
        auto place = [=](Position x, Position y, Position z) {
            return glm::dvec3(double(x) + s, double(y), double(z)) - moved;
        };
        const IndexBox box{{-30 - lattice_shift, -26, -26}, {40 - lattice_shift, 27, 27}};
        FormulaField density("density", box, [=](Position x, Position y, Position z, int) {
            const glm::dvec3 p = place(x, y, z);
            return puff(p.x, p.y, p.z);
        });
        FormulaField glow("glow", box, [=](Position x, Position y, Position z, int) {
            const glm::dvec3 p = place(x, y, z) - glm::dvec3(0, 6, 0);
            return puff(p.x, p.y, p.z);
        });
        FormulaField flow(
            "velocity", box,
            [=](Position x, Position, Position z, int c) {
                return velocity[c] + 0.3 * std::sin(0.2 * double(x + z) + c);
            },
            SampleType::kFloat32, 3);
        std::vector<double> columns{scale, 0, 0, 0, 0, scale, 0, 0, 0, 0, scale, 0, s * scale, 0, 0, 1};
        for (FormulaField* field : {&density, &glow, &flow})
            field->setTransform(*Affine::fromColumns(columns));
        const auto stored = storeFields(scratch_ / "test.bricks", {&density, &glow, &flow}, 8, 1e-3, number);
        ASSERT_TRUE(stored) << stored.error().message;
    }
    void open(bool two) {
        frames_.clear();
        for (std::uint32_t number = 0; number < (two ? 2u : 1u); ++number)
            frames_.push_back(std::make_unique<StreamedFrame>(scratch_ / "test.bricks", number, 3));
    }
    std::vector<RayContext> contexts() {
        std::vector<RayContext> out;
        for (const auto& frame : frames_) out.push_back(frame->context());
        return out;
    }
    MediumChannels channels(std::uint32_t frame, bool moves, bool glows) const {
        MediumChannels out;
        out.density = {frame, &frames_[frame]->channel(0)};
        if (glows) out.emission = {frame, &frames_[frame]->channel(1)};
        if (moves) out.velocity = {frame, &frames_[frame]->channel(2)};
        return out;
    }
    std::vector<StreamedFrame*> all() const {
        std::vector<StreamedFrame*> out;
        for (const auto& frame : frames_) out.push_back(frame.get());
        return out;
    }
    // At random points and times; `coarsest`: level of detail.
    void expectBounds(TracedMedium& medium, int coarsest, const std::string& what) {
        const std::vector<RayContext> contexts = this->contexts();
        bool complete = false;
        readUntilThere(all(), [&] { complete = makeMajorants(medium, coarsest, contexts); });
        ASSERT_TRUE(complete);
        std::mt19937_64 random(11);
        auto uniform = [&](double low, double high) {
            return std::uniform_real_distribution(low, high)(random);
        };
        struct Asked {
            glm::dvec3 point;
            double lod, time;
        };
        std::vector<Asked> asked;
        // A little beyond the box, too.
        const glm::dvec3 size = medium.box_high - medium.box_low;
        for (int i = 0; i < 6000; ++i) {
            glm::dvec3 index;
            for (int a = 0; a < 3; ++a)
                index[a] = uniform(medium.box_low[a] - 0.2 * size[a], medium.box_high[a] + 0.2 * size[a]);
            if (i % 3 == 0)
                for (int a = 0; a < 3; ++a) index[a] = uniform(-16, 16);
            asked.push_back({medium.transform().point(index), i % 2 ? double(coarsest) : uniform(0, coarsest),
                             uniform(medium.time_open, medium.time_close)});
        }
        readUntilThere(all(), [&] {
            MediumReader reader(medium, contexts);
            for (const Asked& ask : asked)
                reader.extinction(ask.point, ask.lod, ask.time),
                    reader.emission(ask.point, ask.lod, ask.time);
        });
        MediumReader reader(medium, contexts);
        double most = 0, most_cell = 0;
        int empty = 0, filled = 0;
        for (const Asked& ask : asked) {
            const double extinction = reader.extinction(ask.point, ask.lod, ask.time);
            const glm::dvec3 emission = reader.emission(ask.point, ask.lod, ask.time);
            const IndexRay ray(WorldRay{ask.point, {0, 0, 1}}, medium.transform());
            const glm::dvec3 p = ray.origin;
            const bool inside = glm::all(glm::lessThanEqual(medium.box_low, p)) &&
                                glm::all(glm::lessThanEqual(p, medium.box_high));
            const MajorantCell cell = inside ? medium.majorants.at(ray, 0).cell : MajorantCell();
            ASSERT_LE(extinction, double(cell.extinction))
                << what << ": lod " << ask.lod << ", time " << ask.time << ", at " << p.x << " " << p.y << " "
                << p.z;
            if (cell.emission == 0) {
                ASSERT_EQ(glm::length(emission), 0) << what << " at " << p.x << " " << p.y << " " << p.z;
            }
            most = std::max(most, extinction);
            most_cell = std::max(most_cell, double(cell.extinction));
            empty += inside && cell.empty();
            filled += inside && extinction > 0;
        }
        EXPECT_FALSE(reader.takeMissed());
        // It says something.
        EXPECT_GT(most, 0) << what;
        EXPECT_GT(filled, 3) << what;
        empty_ = empty;
        tightness_ = most / most_cell;
    }

    ScratchFolder scratch_;
    std::vector<std::unique_ptr<StreamedFrame>> frames_;
    int empty_ = 0;         // of the points of the last expectBounds(), those in empty cells
    double tightness_ = 0;  // most extinction met, over that of the cells
};

TEST_F(MajorantTest, BoundEveryFilterAtEveryLevelOfDetail) {
    store(0, {2.3, -1, 3}, {0, 0, 0});
    open(false);
    for (const FieldFilter filter :
         {FieldFilter::kNearest, FieldFilter::kTrilinear, FieldFilter::kBSpline, FieldFilter::kCatmullRom,
          FieldFilter::kMitchell, FieldFilter::kGaussian})
        for (const int coarsest : {0, 1, 3}) {
            MediumSettings settings;
            settings.density_scale = 0.7;
            settings.filter = filter;
            settings.emission.emplace();
            TracedMedium medium;
            medium.settings = &settings;
            medium.now = channels(0, false, true);
            expectBounds(medium, coarsest,
                         std::string(toString(filter)) + " of level " + std::to_string(coarsest));
            EXPECT_GT(tightness_, 0.2);
            if (coarsest == 0) {
                EXPECT_GT(empty_, 500);
            }
        }
}

TEST_F(MajorantTest, BoundTransferFunctions) {
    store(0, {2.3, -1, 3}, {0, 0, 0});
    open(false);
    // A shell that no sample lies in.
    for (const bool background : {false, true}) {
        MediumSettings settings;
        settings.density_scale = 3;
        settings.transfer = std::make_shared<TransferFunction>(
            std::vector<TransferFunction::Point>{{background ? -1.0 : 0.3, {1, 0, 0}, background ? 0.2 : 0},
                                                 {0.31, {0, 1, 0}, 5},
                                                 {0.32, {0, 0, 1}, 0}});
        TracedMedium medium;
        medium.settings = &settings;
        medium.now = channels(0, false, false);
        expectBounds(medium, 0, "transfer function");
    }
}

TEST_F(MajorantTest, BoundWhatMovesDuringTheShutter) {
    store(0, {2.3, -1, 3}, {5, -3, 1});
    open(false);
    for (const double scale : {1.0, -1.5}) {
        MediumSettings settings;
        settings.velocity_scale = scale;
        settings.emission.emplace();
        TracedMedium medium;
        medium.settings = &settings;
        medium.now = channels(0, true, true);
        medium.time_open = -0.3;
        medium.time_close = 0.8;
        expectBounds(medium, 0, "shutter");
        expectBounds(medium, 1, "shutter");
    }
}

// A velocity whose background is the fastest there is.
TEST_F(MajorantTest, BoundWhatABackgroundOfTheVelocityMoves) {
    FormulaField density(
        "density", {{-12, -12, -12}, {13, 13, 13}},
        [](Position x, Position y, Position z, int) { return puff(double(x), double(y), double(z)); });
    FormulaField glow("glow", {{0, 0, 0}, {1, 1, 1}}, [](auto...) { return 1.0; });
    FormulaField flow(
        "velocity", {{-3, -3, -3}, {4, 4, 4}}, [](auto...) { return 0.1; }, SampleType::kFloat32, 3, 9);
    ASSERT_TRUE(storeFields(scratch_ / "test.bricks", {&density, &glow, &flow}, 8));
    open(false);
    MediumSettings settings;
    TracedMedium medium;
    medium.settings = &settings;
    medium.now = channels(0, true, false);
    medium.time_close = 1;
    expectBounds(medium, 0, "background");
}

TEST_F(MajorantTest, BoundWhatLiesBetweenTwoFrames) {
    for (const bool other_lattice : {false, true}) {
        store(0, {-6, 0, 0}, {12, 0, 0});
        store(1, {6, 0, 0}, {12, 0, 0}, other_lattice ? 24 : 0);
        open(true);
        for (const bool advects : {true, false})
            for (const double between : {0.1, 0.5, 0.9})
                for (const bool transfer : {false, true}) {
                    MediumSettings settings;
                    if (transfer)
                        settings.transfer =
                            std::make_shared<TransferFunction>(std::vector<TransferFunction::Point>{
                                {0.3, {1, 0, 0}, 0}, {0.35, {0, 1, 0}, 5}, {0.4, {0, 0, 1}, 0}});
                    else
                        settings.emission.emplace();
                    TracedMedium medium;
                    medium.settings = &settings;
                    medium.now = channels(0, advects, !transfer);
                    medium.next = channels(1, advects, !transfer);
                    medium.between = between;
                    medium.advects = advects;
                    medium.time_close = 0.05;
                    expectBounds(medium, 0,
                                 "between " + std::to_string(between) + (advects ? " advected" : " blended") +
                                     (other_lattice ? ", lattice moved" : "") +
                                     (transfer ? ", transfer" : ""));
                }
    }
}

// World units that are not voxels.
TEST_F(MajorantTest, AreOfWorldUnits) {
    store(0, {2.3, -1, 3}, {0.002, 0, 0}, 0, 0.001);
    open(false);
    MediumSettings settings;
    settings.density_scale = 1000;
    TracedMedium medium;
    medium.settings = &settings;
    medium.now = channels(0, true, false);
    medium.time_close = 2;
    expectBounds(medium, 1, "small world");
}

}  // namespace
}  // namespace brickyard
