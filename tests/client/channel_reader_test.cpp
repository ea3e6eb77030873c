// Values at any point, held against convolutions written down from the kernels' definitions.
#include "client/trace/channel_reader.h"

#include <cmath>
#include <random>

#include "blob_field.h"
#include "client/trace/node_fields.h"
#include "streamed_frame.h"

namespace brickyard {
namespace {

constexpr FieldFilter kFilters[] = {FieldFilter::kNearest,  FieldFilter::kTrilinear,
                                    FieldFilter::kBSpline,  FieldFilter::kCatmullRom,
                                    FieldFilter::kMitchell, FieldFilter::kGaussian};

// The kernels themselves, of the distance in samples.
double kernel(FieldFilter filter, double x) {
    x = std::abs(x);
    switch (filter) {
        case FieldFilter::kNearest: return 0;  // see convolved()
        case FieldFilter::kTrilinear: return std::max(0.0, 1 - x);
        case FieldFilter::kBSpline:
            if (x < 1) return 2.0 / 3 - x * x + x * x * x / 2;
            return x < 2 ? std::pow(2 - x, 3) / 6 : 0;
        case FieldFilter::kCatmullRom:
            if (x < 1) return 1.5 * x * x * x - 2.5 * x * x + 1;
            return x < 2 ? -0.5 * x * x * x + 2.5 * x * x - 4 * x + 2 : 0;
        case FieldFilter::kMitchell:
            if (x < 1) return (7 * x * x * x - 12 * x * x + 16.0 / 3) / 6;
            return x < 2 ? (-7.0 / 3 * x * x * x + 12 * x * x - 20 * x + 32.0 / 3) / 6 : 0;
        case FieldFilter::kGaussian: return std::exp(-0.5 * (x / 0.5) * (x / 0.5));
    }
    return 0;
}

// `sample(x, y, z)`: on the integers. `p`: in samples.
template <class Sample>
double convolved(FieldFilter filter, const glm::dvec3& p, Sample sample) {
    if (filter == FieldFilter::kNearest) {
        const glm::dvec3 at = glm::floor(p + 0.5);
        return sample(std::int64_t(at.x), std::int64_t(at.y), std::int64_t(at.z));
    }
    double sum = 0, weights = 0;
    const glm::dvec3 base = glm::floor(p);
    for (int k = -1; k < 3; ++k)
        for (int j = -1; j < 3; ++j)
            for (int i = -1; i < 3; ++i) {
                const glm::dvec3 at = base + glm::dvec3(i, j, k);
                const double weight =
                    kernel(filter, p.x - at.x) * kernel(filter, p.y - at.y) * kernel(filter, p.z - at.z);
                weights += weight;
                if (weight != 0)
                    sum += weight * sample(std::int64_t(at.x), std::int64_t(at.y), std::int64_t(at.z));
            }
    return sum / weights;
}

struct Points {
    std::mt19937_64 random{1};
    glm::dvec3 low, high;
    double edge;  // of a brick
    double uniform(double a, double b) { return std::uniform_real_distribution(a, b)(random); }
    // Every third next to a border of bricks, every third on the lattice.
    glm::dvec3 next(int trial) {
        glm::dvec3 p(uniform(low.x, high.x), uniform(low.y, high.y), uniform(low.z, high.z));
        if (trial % 3 == 1)
            p = edge * glm::round(p / edge) + glm::dvec3(uniform(-2, 2), uniform(-2, 2), uniform(-2, 2));
        if (trial % 3 == 2) {
            const int axis = int(random() % 3);
            p[axis] = std::round(p[axis]);
            if (trial % 2) p = glm::floor(p);
        }
        return p;
    }
};

// Rough on one side, linear in the middle, of one value on the other, over a background that is not 0: leaves
// of many levels.
double mixedValue(double x, double y, double z) {
    if (x > 18) return 0.5;
    const double smooth = 0.5 + 0.02 * (18 - x) * (y + z) / 40;
    return x < -6 ? smooth + 0.3 * std::sin(1.1 * x + 2.3 * y) * std::cos(1.9 * z - x * y) : smooth;
}

class ChannelReaderTest : public testing::Test {
protected:
    void store(const FieldSource& field, int edge, double max_error = 0, int components = 1) {
        const auto stored = storeFields(scratch_ / "field.bricks", {&field}, edge, max_error);
        ASSERT_TRUE(stored) << stored.error().message;
        frame_ = std::make_unique<StreamedFrame>(scratch_ / "field.bricks", 0, components);
    }
    template <class Read>
    void read(FieldFilter filter, const std::vector<glm::dvec3>& points, Read each) {
        const RayContext context = frame_->context();
        readUntilThere({frame_.get()}, [&] {
            ChannelReader reader(frame_->channel(), filter, {}, context);
            for (const glm::dvec3& p : points)
                reader.value(p, 0), reader.value(p, 1), reader.value(p, 2.5), reader.gradient(p, 0);
        });
        ChannelReader reader(frame_->channel(), filter, {}, context);
        for (const glm::dvec3& p : points) each(reader, p);
        EXPECT_FALSE(reader.takeMissed());
    }
    static std::vector<glm::dvec3> points(int count, const glm::dvec3& low, const glm::dvec3& high,
                                          double edge) {
        Points of{std::mt19937_64(7), low, high, edge};
        std::vector<glm::dvec3> out;
        for (int i = 0; i < count; ++i) out.push_back(of.next(i));
        return out;
    }
    // The stored field of a level, by another way through the octree.
    double stored(NodeFields& fields, int level, std::int64_t x, std::int64_t y, std::int64_t z) {
        const NodeFields::NodeField field = fields.sample(level, {x, y, z});
        EXPECT_EQ(field.state, NodeFields::State::kValue);
        return field.value;
    }

    ScratchFolder scratch_;
    std::unique_ptr<StreamedFrame> frame_;
};

TEST_F(ChannelReaderTest, TheFinestLevelIsAConvolutionOfTheSamples) {
    const FormulaField field = FormulaField(
        "density", {{-37, -20, -18}, {40, 21, 23}},
        [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
            return mixedValue(double(x), double(y), double(z));
        },
        SampleType::kFloat32, 1, 0.25);
    for (const int edge : {8, 16}) {
        store(field, edge);
        const auto where = points(4000, {-44, -28, -26}, {48, 28, 30}, edge);
        for (const FieldFilter filter : kFilters)
            read(filter, where, [&](ChannelReader& reader, const glm::dvec3& p) {
                const double truth =
                    convolved(filter, p, [&](auto x, auto y, auto z) { return field.at(x, y, z); });
                ASSERT_NEAR(reader.value(p, 0), truth, 1e-6)
                    << toString(filter) << " bricks of " << edge << " at " << p.x << " " << p.y << " " << p.z;
            });
    }
}

// Lossy: leaves of coarse levels, and bricks that disagree on their faces by a rounding.
TEST_F(ChannelReaderTest, LevelsOfDetailAreConvolutionsOfTheirSamplesAndBlendInBetween) {
    const FormulaField field = FormulaField(
        "density", {{-37, -20, -18}, {60, 21, 23}},
        [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
            return mixedValue(double(x), double(y), double(z));
        },
        SampleType::kFloat32, 1, 0.25);
    for (const double max_error : {0.0, 1e-3})
        for (const int edge : {8, 16}) {
            store(field, edge, max_error);
            const auto where = points(700, {-44, -28, -26}, {66, 28, 30}, edge);
            const RayContext context = frame_->context();
            int leaves_above = 0;
            for (const FieldFilter filter : kFilters)
                for (const double lod : {0.0, 0.5, 1.0, 1.3, 2.5}) {
                    int top = 0;
                    for (const NodeKey& root : frame_->channel().roots())
                        top = std::max(top, int(root.level));
                    const int level = std::min(int(lod), top);
                    const double share = level < top ? lod - level : 0;
                    NodeFields fields(frame_->channel(), context, 1, MissingPages::kWant);
                    auto truthOn = [&](int on, const glm::dvec3& p) {
                        return convolved(filter, p / std::exp2(on),
                                         [&](auto x, auto y, auto z) { return stored(fields, on, x, y, z); });
                    };
                    readUntilThere({frame_.get()}, [&] {
                        ChannelReader reader(frame_->channel(), filter, {}, context);
                        for (const glm::dvec3& p : where) {
                            reader.value(p, lod);
                            reader.cellEdgeAt(p, lod);
                            for (int on : {level, std::min(level + 1, top)})
                                convolved(filter, p / std::exp2(on),
                                          [&](std::int64_t x, std::int64_t y, std::int64_t z) {
                                              return fields.sample(on, {x, y, z}).value;
                                          });
                        }
                    });
                    ChannelReader reader(frame_->channel(), filter, {}, context);
                    for (const glm::dvec3& p : where) {
                        const double fine = truthOn(level, p),
                                     coarse = share > 0 ? truthOn(level + 1, p) : fine;
                        // Faces of bricks are quantised each by itself.
                        ASSERT_NEAR(reader.value(p, lod), fine + share * (coarse - fine),
                                    level + share > 0 || max_error > 0 ? 0.02 : 1e-6)
                            << toString(filter) << " lod " << lod << " bricks of " << edge << " at " << p.x
                            << " " << p.y << " " << p.z;
                        leaves_above += reader.cellEdgeAt(p, lod) > std::exp2(level);
                    }
                    EXPECT_FALSE(reader.takeMissed());
                }
            if (max_error > 0 && edge == 8) {
                EXPECT_GT(leaves_above, 100);
            }
        }
}

TEST_F(ChannelReaderTest, ConstantsAndLinearFieldsComeBackAsTheyAre) {
    for (const bool linear : {false, true}) {
        const FormulaField field(
            "density", {{-40, -40, -40}, {41, 41, 41}},
            [=](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                return linear ? 3 + 0.5 * double(x) - 0.25 * double(y) + 0.125 * double(z) : 7.0;
            });
        store(field, 8);
        for (const FieldFilter filter : kFilters) {
            if (linear && (filter == FieldFilter::kNearest || filter == FieldFilter::kGaussian)) continue;
            read(filter, points(500, {-30, -30, -30}, {30, 30, 30}, 8),
                 [&](ChannelReader& reader, const glm::dvec3& p) {
                     const double truth = linear ? 3 + 0.5 * p.x - 0.25 * p.y + 0.125 * p.z : 7;
                     for (const double lod : {0.0, 0.7, 1.3})
                         ASSERT_NEAR(reader.value(p, lod), truth, lod > 0 ? 0.1 : 1e-5)
                             << toString(filter) << " " << lod;
                     const glm::dvec3 slope = reader.gradient(p, 0);
                     ASSERT_LT(glm::length(slope - (linear ? glm::dvec3(0.5, -0.25, 0.125) : glm::dvec3(0))),
                               1e-5);
                 });
        }
    }
}

TEST_F(ChannelReaderTest, WhatIsMissingIsWantedAndReportedOnce) {
    store(roughBlobField(), 8);
    const RayContext context = frame_->context();
    const glm::dvec3 p(3.3, 4.4, 5.5);
    ChannelReader first(frame_->channel(), FieldFilter::kTrilinear, {}, context);
    EXPECT_TRUE(std::isfinite(first.value(p, 0)));
    EXPECT_TRUE(first.takeMissed());
    EXPECT_FALSE(first.takeMissed());
    // The same entry, still missing: each result that is a stand-in says so.
    first.value(p + 0.1, 0);
    EXPECT_TRUE(first.takeMissed());
    int rounds = 0;
    for (; frame_->arrive(); ++rounds) {
        ChannelReader reader(frame_->channel(), FieldFilter::kTrilinear, {}, context);
        const double value = reader.value(p, 0);
        EXPECT_EQ(reader.takeMissed(), !frame_->wants().empty());
        EXPECT_TRUE(value >= 0 && value <= 1.5) << value;
    }
    EXPECT_GE(rounds, 1);
    // A kernel that reaches into neighbours wants those.
    const glm::dvec3 corner(8.1, 8.1, 8.1);
    readUntilThere({frame_.get()}, [&] {
        ChannelReader(frame_->channel(), FieldFilter::kTrilinear, {}, context).value(corner, 0);
    });
    ChannelReader wide(frame_->channel(), FieldFilter::kBSpline, {}, context);
    wide.value(corner, 0);
    EXPECT_TRUE(wide.takeMissed());
    EXPECT_EQ(frame_->wants().size(), 6u);  // of 8; two are there
}

// Components at their own places.
class StaggeredField final : public FieldSource {
public:
    explicit StaggeredField(const FormulaField& field) : field_(field), info_(field.info()) {
        info_.grid_class = "staggered";
    }
    const ChannelInfo& info() const override { return info_; }
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override {
        return field_.uniformOver(box);
    }
    Result<void> read(const IndexBox& box, SampleBlock& out) const override { return field_.read(box, out); }

private:
    const FormulaField& field_;
    ChannelInfo info_;
};

TEST_F(ChannelReaderTest, VectorsAreReadByComponentAndStaggeredOnesPutBack) {
    const FormulaField field(
        "velocity", {{-20, -20, -20}, {21, 21, 21}},
        [](std::int64_t x, std::int64_t y, std::int64_t z, int c) {
            return std::sin(0.3 * double(x + c)) + 0.1 * double(y) * c - 0.05 * double(z * z);
        },
        SampleType::kFloat32, 3);
    const StaggeredField staggered(field);
    for (const bool shifted : {false, true}) {
        store(shifted ? static_cast<const FieldSource&>(staggered) : field, 8, 0, 3);
        ASSERT_EQ(frame_->channel().staggered(), shifted);
        const auto where = points(1000, {-24, -24, -24}, {24, 24, 24}, 8);
        const RayContext context = frame_->context();
        readUntilThere({frame_.get()}, [&] {
            ChannelReader reader(frame_->channel(), FieldFilter::kTrilinear, {}, context);
            for (const glm::dvec3& p : where) reader.vector(p, 0);
        });
        ChannelReader reader(frame_->channel(), FieldFilter::kTrilinear, {}, context);
        for (const glm::dvec3& p : where) {
            const glm::dvec3 value = reader.vector(p, 0);
            for (int c = 0; c < 3; ++c) {
                glm::dvec3 at = p;
                // OpenVDB: component c of index (i, j, k) lies half a voxel below it on axis c.
                if (shifted) at[c] += 0.5;
                const double truth = convolved(FieldFilter::kTrilinear, at,
                                               [&](auto x, auto y, auto z) { return field.at(x, y, z, c); });
                ASSERT_NEAR(value[c], truth, 2e-5)
                    << "component " << c << " at " << p.x << " " << p.y << " " << p.z;
            }
        }
    }
}

// Cells in which value() is smooth: second differences of a cubic along an axis show what is not.
TEST_F(ChannelReaderTest, ValuesAreSmoothInTheCellsItTells) {
    const FormulaField field(
        "density", {{-37, -20, -18}, {60, 21, 23}},
        [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
            return mixedValue(double(x), double(y), double(z));
        },
        SampleType::kFloat32, 1, 0.25);
    store(field, 8, 1e-3);
    for (const FieldFilter filter : kFilters)
        for (const double lod : {0.0, 0.5, 1.0}) {
            // In between, walks take half of it.
            if (filter == FieldFilter::kNearest && lod == 0.5) continue;
            if (filter == FieldFilter::kGaussian) continue;  // no polynomial
            const RayContext context = frame_->context();
            const auto where = points(600, {-40, -24, -22}, {64, 24, 26}, 8);
            // Across the cell, along x: a cubic at most. Its fourth differences vanish.
            auto fourthDifference = [&](ChannelReader& reader, const glm::dvec3& p) {
                const double edge = reader.cellEdgeAt(p, lod),
                             shift = filter == FieldFilter::kNearest ? 0.5 : 0;
                const double low = (std::floor(p.x / edge - shift) + shift) * edge;
                double v[5];
                for (int i = 0; i < 5; ++i)
                    v[i] = reader.value({low + edge * (0.02 + 0.24 * i), p.y, p.z}, lod);
                return v[0] - 4 * v[1] + 6 * v[2] - 4 * v[3] + v[4];
            };
            readUntilThere({frame_.get()}, [&] {
                ChannelReader reader(frame_->channel(), filter, {}, context);
                for (const glm::dvec3& p : where) fourthDifference(reader, p);
            });
            ChannelReader reader(frame_->channel(), filter, {}, context);
            for (const glm::dvec3& p : where)
                ASSERT_NEAR(fourthDifference(reader, p), 0, 2e-3)
                    << toString(filter) << " lod " << lod << " at " << p.x << " " << p.y << " " << p.z;
        }
}

}  // namespace
}  // namespace brickyard
