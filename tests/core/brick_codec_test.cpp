#include "core/brick_codec.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <functional>
#include <limits>
#include <random>
#include <string>

#include "core/half.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

// A brick to encode that owns what BrickToEncode refers to.
struct Brick {
    BrickShape shape{8};
    SampleType type = SampleType::kFloat32;
    int components = 1;
    std::vector<std::byte> values;
    std::vector<std::uint8_t> active;
    std::vector<ValueBits> background{0, 0, 0};

    Brick(SampleType sample_type, int edge_cells, int component_count = 1)
        : shape{edge_cells}, type(sample_type), components(component_count) {
        values.resize(count() * sampleBytes(type));
    }
    std::size_t count() const { return shape.samples() * std::size_t(components); }

    void set(std::size_t i, ValueBits bits) {
        std::memcpy(&values[i * sampleBytes(type)], &bits, sampleBytes(type));
    }
    ValueBits get(std::size_t i) const { return bitsAt(values, i); }
    ValueBits bitsAt(const std::vector<std::byte>& from, std::size_t i) const {
        ValueBits bits = 0;
        std::memcpy(&bits, &from[i * sampleBytes(type)], sampleBytes(type));
        return bits;
    }
    // Every sample of every component from a formula.
    Brick& fill(const std::function<double(int x, int y, int z, int c)>& formula) {
        const int n = shape.edgeSamples();
        for (int c = 0; c < components; ++c)
            for (int z = 0; z < n; ++z)
                for (int y = 0; y < n; ++y)
                    for (int x = 0; x < n; ++x)
                        set(shape.sampleAt(x, y, z) + std::size_t(c) * shape.samples(),
                            fromDouble(type, formula(x, y, z, c)));
        return *this;
    }
    Brick& fillBits(const std::function<ValueBits()>& next) {
        for (std::size_t i = 0; i < count(); ++i) set(i, next());
        return *this;
    }

    EncodedBrick encode(double max_error = 0, double draft_error = 0) const {
        return encodeBrick({shape, type, components, values, active, background, max_error, draft_error});
    }
    Result<DecodedBrick> decode(std::span<const std::byte> payload) const {
        return decodeBrick(payload, shape, type, components, background);
    }
};

double wave(int x, int y, int z, int c) {
    return 40 * std::sin(0.31 * x + 0.17 * c) * std::cos(0.23 * y) + 3 * std::sin(0.71 * z + x * 0.05) +
           10 * c;
}

std::vector<Brick> variousBricks() {
    std::vector<Brick> bricks;
    std::mt19937_64 random(7);
    for (const SampleType type : {SampleType::kFloat32, SampleType::kFloat64, SampleType::kInt32,
                                  SampleType::kInt64, SampleType::kBool})
        for (const int components : {1, 3})
            for (const int edge : {8, 16}) {
                bricks.push_back(Brick(type, edge, components).fill(wave));
                // Large values and large differences; for integers also a span of all their bits.
                bricks.push_back(Brick(type, edge, components).fill([&](int x, int, int z, int) {
                    return (x + z) % 2 ? 1e30 : -1e30 * std::ldexp(1.0, -z);
                }));
                bricks.push_back(Brick(type, edge, components).fill([&](int x, int y, int z, int) {
                    return x == 3 && y == 2 && z == 1 ? 1 : 0;
                }));
                bricks.push_back(Brick(type, edge, components).fillBits([&] {
                    return type == SampleType::kBool ? random() % 2 : random();
                }));
            }
    return bricks;
}

std::string describe(const Brick& brick) {
    return std::string(toString(brick.type)) + " x" + std::to_string(brick.components) + ", edge " +
           std::to_string(brick.shape.edge_cells);
}

TEST(BrickCodecTest, ErrorZeroIsBitExact) {
    for (const Brick& brick : variousBricks()) {
        const EncodedBrick encoded = brick.encode();
        EXPECT_EQ(encoded.error_made, 0);
        EXPECT_LE(encoded.payload.size(), brick.values.size() + 64) << describe(brick);
        const auto decoded = brick.decode(encoded.payload);
        ASSERT_TRUE(decoded) << decoded.error().message;
        EXPECT_EQ(decoded->type, brick.type);
        EXPECT_TRUE(decoded->values == brick.values) << describe(brick);
        EXPECT_TRUE(decoded->active.empty());
    }
}

TEST(BrickCodecTest, SpecialNumbersKeepTheirBits) {
    const std::uint32_t specials[] = {0x00000000, 0x80000000, 0x00000001, 0x807fffff, 0x00800000, 0x7f7fffff,
                                      0xff7fffff, 0x7f800000, 0xff800000, 0x7fc00001, 0x7f800001, 0xffffffff};
    Brick floats(SampleType::kFloat32, 8), doubles(SampleType::kFloat64, 8);
    for (std::size_t i = 0; i < floats.count(); ++i) {
        floats.set(i, specials[i % std::size(specials)]);
        doubles.set(i, ValueBits(specials[i % std::size(specials)]) << 32 | (i % 5 == 0 ? 1 : 0));
    }
    for (const Brick& brick : {floats, doubles})
        for (const double max_error : {0.0, 0.5}) {
            const EncodedBrick encoded = brick.encode(max_error);
            EXPECT_EQ(encoded.error_made, 0)
                << "NaN and infinity have no distance, so nothing may be approximated";
            const auto decoded = brick.decode(encoded.payload);
            ASSERT_TRUE(decoded) << decoded.error().message;
            EXPECT_TRUE(decoded->values == brick.values) << describe(brick);
        }
}

TEST(BrickCodecTest, TheErrorNeverExceedsItsBoundAndIsReported) {
    std::mt19937_64 random(3);
    std::vector<Brick> bricks;
    for (const SampleType type : {SampleType::kFloat32, SampleType::kFloat64}) {
        bricks.push_back(Brick(type, 8).fill(wave));
        bricks.push_back(Brick(type, 8, 3).fill(wave));
        bricks.push_back(Brick(type, 8).fill([](int x, int y, int, int) { return 1e6 + x + 1e-3 * y; }));
        bricks.push_back(Brick(type, 8).fill([](int x, int, int z, int) { return x * 1e-40 - z * 1e-44; }));
        bricks.push_back(Brick(type, 8).fill([](int x, int, int, int) { return x % 2 ? 3e38 : -3e38; }));
        bricks.push_back(
            Brick(type, 16).fill([&](int, int, int, int) { return double(random() % 1000) * 1e-3; }));
    }
    for (const Brick& brick : bricks)
        for (int exponent = -330; exponent<300; exponent += exponent> - 20 && exponent < 10 ? 1 : 20) {
            const double max_error = std::max(5e-324, std::pow(10.0, exponent) * 0.7);
            const EncodedBrick encoded = brick.encode(max_error);
            const auto decoded = brick.decode(encoded.payload);
            ASSERT_TRUE(decoded) << decoded.error().message;
            double error = 0;
            for (std::size_t i = 0; i < brick.count(); ++i)
                error = std::max(error, std::abs(toDouble(brick.type, brick.bitsAt(decoded->values, i)) -
                                                 toDouble(brick.type, brick.get(i))));
            ASSERT_LE(error, max_error) << describe(brick);
            ASSERT_EQ(error, encoded.error_made) << describe(brick) << " at " << max_error;
        }
}

TEST(BrickCodecTest, AnAllowedErrorSavesBytes) {
    const Brick brick = Brick(SampleType::kFloat32, 16).fill(wave);
    const std::size_t exact = brick.encode().payload.size();
    EXPECT_LT(brick.encode(1e-3).payload.size(), exact / 2);
    EXPECT_LT(brick.encode(0.1).payload.size(), brick.encode(1e-3).payload.size());
    EXPECT_LT(brick.encode(100).payload.size(), 16u) << "half the range is allowed, so one value will do";
}

TEST(BrickCodecTest, AnErrorNeverCostsBytes) {
    const Brick brick = Brick(SampleType::kFloat32, 16).fill([](int x, int, int, int) { return x % 2; });
    const std::size_t exact = brick.encode().payload.size();
    for (const double max_error : {1e-9, 1e-6, 1e-3, 0.1})
        EXPECT_LE(brick.encode(max_error).payload.size(), exact);
}

// Zero is what outside is made of: a quantiser that moved it would fill the air with haze.
TEST(BrickCodecTest, ZeroStaysZero) {
    const Brick brick = Brick(SampleType::kFloat32, 8).fill([](int x, int y, int z, int c) {
        return x < 4 ? 0 : wave(x, y, z, c) - 7.7;
    });
    const auto decoded = brick.decode(brick.encode(0.013).payload);
    ASSERT_TRUE(decoded);
    for (std::size_t i = 0; i < brick.count(); ++i) {
        if (brick.get(i) == 0) {
            ASSERT_EQ(brick.bitsAt(decoded->values, i), 0u);
        }
    }
}

TEST(BrickCodecTest, NeighboursAgreeOnTheSamplesTheyShare) {
    const auto left = Brick(SampleType::kFloat32, 8).fill(wave);
    const auto right =
        Brick(SampleType::kFloat32, 8).fill([](int x, int y, int z, int c) { return wave(x + 8, y, z, c); });
    const auto a = left.decode(left.encode(0.01).payload), b = right.decode(right.encode(0.01).payload);
    ASSERT_TRUE(a && b);
    for (int z = 0; z <= 8; ++z)
        for (int y = 0; y <= 8; ++y)
            ASSERT_EQ(left.bitsAt(a->values, left.shape.sampleAt(8, y, z)),
                      right.bitsAt(b->values, right.shape.sampleAt(0, y, z)));
}

TEST(BrickCodecTest, NarrowNumbersAreStoredNarrow) {
    std::mt19937 random(5);
    const auto noise = [&](SampleType type, const std::function<ValueBits()>& next) {
        return double(Brick(type, 16).fillBits(next).encode().payload.size()) /
               double(BrickShape{16}.samples());
    };
    const auto half = [&] { return floatFromHalf(std::uint16_t(random() & 0xfbff & ~0x4000u)); };
    EXPECT_LT(noise(SampleType::kFloat32, [&] { return std::bit_cast<std::uint32_t>(half()); }), 2.05);
    EXPECT_LT(noise(SampleType::kFloat64, [&] { return std::bit_cast<ValueBits>(double(half())); }), 2.05);
    EXPECT_LT(noise(SampleType::kFloat64,
                    [&] {
                        return std::bit_cast<ValueBits>(
                            double(std::bit_cast<float>(std::uint32_t(random() & 0xbfffffffu))));
                    }),
              4.05);
    EXPECT_LT(noise(SampleType::kInt32, [&] { return std::uint32_t(-1000000000) + random() % 200; }), 1.05);
    EXPECT_LT(noise(SampleType::kInt64, [&] { return ValueBits(-5) + random() % 60000; }), 2.05);
    EXPECT_LT(noise(SampleType::kInt64, [&] { return (ValueBits(1) << 62) + random(); }), 4.05);
}

TEST(BrickCodecTest, FloatsForRenderersAreTheDecodedValuesRounded) {
    std::vector<Brick> bricks = variousBricks();
    Brick infinite(SampleType::kFloat32, 8);
    for (std::size_t i = 0; i < infinite.count(); ++i)
        infinite.set(i, i % 3 == 0 ? 0x7f800000u : i % 3 == 1 ? 0xff800000u : 0x7fc00000u);
    bricks.push_back(infinite);
    bricks.push_back(Brick(SampleType::kFloat64, 8).fill([](int x, int y, int, int) {
        return (y - 4) * std::pow(10.0, 40 * x);
    }));
    for (const Brick& brick : bricks)
        for (const double max_error : {0.0, 0.01, 1e29}) {
            const auto payload = brick.encode(max_error).payload;
            const auto decoded = brick.decode(payload);
            std::vector<float> floats(brick.count());
            ASSERT_TRUE(decoded &&
                        decodeBrickToFloat(payload, brick.shape, brick.type, brick.components, floats));
            for (std::size_t i = 0; i < brick.count(); ++i)
                ASSERT_EQ(std::bit_cast<std::uint32_t>(floats[i]),
                          std::bit_cast<std::uint32_t>(toFloat(brick.type, brick.bitsAt(decoded->values, i))))
                    << describe(brick) << ", sample " << i;
        }
}

TEST(BrickCodecTest, StatesComeBackHoweverTheyAreKept) {
    std::mt19937 random(11);
    const Brick field = Brick(SampleType::kFloat32, 8, 3).fill([](int x, int y, int, int c) {
        return x > 3 && c == 1 ? y + 1 : 0;
    });
    const Brick constant = Brick(SampleType::kInt32, 8).fill([](int, int, int, int) { return 7; });
    for (Brick brick : {field, constant}) {
        std::vector<std::vector<std::uint8_t>> kinds(5, std::vector<std::uint8_t>(brick.shape.cells(), 0));
        for (std::size_t i = 0; i < brick.shape.cells(); ++i) {
            kinds[1][i] = 1;
            kinds[2][i] = i % 8 > 3;  // exactly where `field` is not its background
            kinds[3][i] = std::uint8_t(random() % 2);
            kinds[4][i] = i == 77;
        }
        for (const double max_error : {0.0, 0.01, 100.0})
            for (const auto& states : kinds) {
                brick.active = states;
                const auto decoded = brick.decode(brick.encode(max_error).payload);
                ASSERT_TRUE(decoded) << decoded.error().message;
                EXPECT_TRUE(decoded->active == states) << describe(brick);
            }
    }
}

TEST(BrickCodecTest, StatesThatFollowFromTheValuesCostNothing) {
    Brick brick = Brick(SampleType::kFloat32, 16).fill([](int x, int y, int z, int c) {
        return (x * y + z) % 5 ? wave(x, y, z, c) : 0;
    });
    const std::size_t without = brick.encode().payload.size();
    brick.active.resize(brick.shape.cells());
    for (int z = 0; z < 16; ++z)
        for (int y = 0; y < 16; ++y)
            for (int x = 0; x < 16; ++x) brick.active[brick.shape.cellAt(x, y, z)] = (x * y + z) % 5 != 0;
    EXPECT_EQ(brick.encode().payload.size(), without);
    brick.active[0] ^= 1;
    EXPECT_GT(brick.encode().payload.size(), without);
}

TEST(BrickCodecTest, OneValueTakesAFewBytes) {
    Brick brick = Brick(SampleType::kFloat64, 64, 3).fill([](int, int, int, int c) { return 1.0 / (c + 3); });
    brick.active.assign(brick.shape.cells(), 1);
    const auto encoded = brick.encode();
    EXPECT_EQ(encoded.payload.size(), 5u + 3 * 8);
    const auto decoded = brick.decode(encoded.payload);
    ASSERT_TRUE(decoded);
    EXPECT_TRUE(decoded->values == brick.values);
}

TEST(BrickCodecTest, TheLargestBrickComesBack) {
    const Brick brick = Brick(SampleType::kFloat32, 64, 3).fill(wave);
    const auto encoded = brick.encode();
    EXPECT_LE(encoded.payload.size(), kMaxPayloadBytes);
    const auto decoded = brick.decode(encoded.payload);
    ASSERT_TRUE(decoded);
    EXPECT_TRUE(decoded->values == brick.values);
}

TEST(BrickCodecTest, ValuesNeedNoAlignment) {
    const Brick brick = Brick(SampleType::kFloat64, 8).fill(wave);
    std::vector<std::byte> shifted(brick.values.size() + 1);
    std::copy(brick.values.begin(), brick.values.end(), shifted.begin() + 1);
    const auto encoded =
        encodeBrick({brick.shape, brick.type, 1, std::span(shifted).subspan(1), {}, brick.background, 0});
    EXPECT_TRUE(encoded.payload == brick.encode().payload);
}

// Smooth, with mantissas that no quantiser keeps: what drafts are for.
Brick turbulent(SampleType type, int edge, int components = 1) {
    std::mt19937_64 random(19);
    return Brick(type, edge, components).fill([&](int x, int y, int z, int c) {
        return x < 2 ? 0 : wave(x, y, z, c) + 1e-2 * double(random() % (1u << 24)) / (1u << 24);
    });
}

double largestDeviation(const Brick& brick, const std::vector<std::byte>& values) {
    double largest = 0;
    for (std::size_t i = 0; i < brick.count(); ++i)
        largest = std::max(largest, std::abs(toDouble(brick.type, brick.bitsAt(values, i)) -
                                             toDouble(brick.type, brick.get(i))));
    return largest;
}

Result<DecodedBrick> draftOf(const Brick& brick, const EncodedBrick& encoded) {
    return decodeDraft(std::span(encoded.payload).first(encoded.draft_bytes), brick.shape, brick.type,
                       brick.components);
}

TEST(BrickDraftTest, ADraftTakesAFractionAndTheWholeStaysExact) {
    for (const SampleType type : {SampleType::kFloat32, SampleType::kFloat64})
        for (const int components : {1, 3}) {
            Brick brick = turbulent(type, 16, components);
            brick.active.resize(brick.shape.cells());
            for (std::size_t i = 0; i < brick.active.size(); ++i) brick.active[i] = i % 7 == 0;
            const EncodedBrick plain = brick.encode(), drafted = brick.encode(0, 0.05);
            EXPECT_EQ(plain.draft_bytes, 0u);
            ASSERT_GT(drafted.draft_bytes, 0u) << describe(brick);
            EXPECT_LT(double(drafted.draft_bytes), 0.5 * double(plain.payload.size())) << describe(brick);
            EXPECT_LE(double(drafted.payload.size()), 1.17 * double(plain.payload.size()) + 1)
                << describe(brick);
            EXPECT_EQ(drafted.error_made, 0);

            const auto exact = brick.decode(drafted.payload);
            ASSERT_TRUE(exact) << exact.error().message;
            EXPECT_TRUE(exact->values == brick.values) << describe(brick);
            EXPECT_TRUE(exact->active == brick.active) << describe(brick);
        }
}

TEST(BrickDraftTest, TheDraftIsWithinItsErrorAndReportsIt) {
    std::mt19937_64 random(23);
    std::vector<Brick> bricks = variousBricks();
    for (const SampleType type : {SampleType::kFloat32, SampleType::kFloat64}) {
        bricks.push_back(turbulent(type, 16, 3));
        // Halves; halves at the end of their range, whose drafts may lie beyond it; denormals; both zeros.
        bricks.push_back(Brick(type, 8).fill([&](int x, int, int, int) {
            return double(floatFromHalf(std::uint16_t(0x3000u + unsigned(x) * 64 + random() % 64)));
        }));
        bricks.push_back(
            Brick(type, 8).fill([&](int, int, int, int) { return 65504.0 - 32 * double(random() % 200); }));
        bricks.push_back(
            Brick(type, 8).fill([&](int, int, int, int) { return 1e-41 * double(random() % 2000); }));
        bricks.push_back(Brick(type, 8).fill([&](int x, int, int, int) {
            return x % 3 == 0 ? -0.0 : x % 3 == 1 ? 0.0 : double(random() % 100003) * 1e-5;
        }));
        bricks.push_back(Brick(type, 8).fill([&](int, int, int, int) {
            return (random() % 2 ? 3.4028234e38 : -3.4028234e38) * (1 - 1e-7 * double(random() % 100));
        }));
    }
    // A float64 brick of floats: its draft may leave the range of the width that it is kept at.
    bricks.push_back(Brick(SampleType::kFloat64, 8).fill([&](int, int, int, int) {
        return double(float(3.4028234e38 * (1 - 1e-7 * double(random() % 1000))));
    }));

    std::size_t drafts = 0, constant_drafts = 0;
    for (const Brick& brick : bricks)
        for (int exponent = -325; exponent < 309; exponent += std::abs(exponent) < 40 ? 4 : 20) {
            if (!isFloating(brick.type) && exponent % 20 != -5) continue;  // these have none at any error
            const double draft_error = std::max(5e-324, std::pow(10.0, exponent) * 0.7);
            const EncodedBrick encoded = brick.encode(0, draft_error);
            const auto exact = brick.decode(encoded.payload);
            ASSERT_TRUE(exact) << exact.error().message;
            ASSERT_TRUE(exact->values == brick.values) << describe(brick) << " at " << draft_error;
            if (encoded.draft_bytes == 0) {
                ASSERT_TRUE(encoded.payload == brick.encode().payload) << "no draft, but not plain either";
                continue;
            }
            ++drafts;
            constant_drafts += encoded.payload[1] == std::byte{0x80};
            ASSERT_LT(encoded.draft_bytes, encoded.payload.size());
            ASSERT_TRUE(isFloating(brick.type)) << describe(brick);
            const auto draft = draftOf(brick, encoded);
            ASSERT_TRUE(draft) << draft.error().message;
            EXPECT_TRUE(draft->active.empty());
            ASSERT_LE(encoded.draft_error_made, draft_error) << describe(brick);
            ASSERT_EQ(largestDeviation(brick, draft->values), encoded.draft_error_made) << describe(brick);

            std::vector<float> floats(brick.count()), exact_floats(brick.count());
            ASSERT_TRUE(decodeDraftToFloat(std::span(encoded.payload).first(encoded.draft_bytes), brick.shape,
                                           brick.type, brick.components, floats));
            ASSERT_TRUE(
                decodeBrickToFloat(encoded.payload, brick.shape, brick.type, brick.components, exact_floats));
            for (std::size_t i = 0; i < brick.count(); ++i) {
                ASSERT_EQ(floats[i], toFloat(brick.type, brick.bitsAt(draft->values, i)));
                ASSERT_EQ(exact_floats[i], toFloat(brick.type, brick.get(i)));
            }
        }
    EXPECT_GT(drafts, 100u);
    EXPECT_GT(constant_drafts, 10u);
}

TEST(BrickDraftTest, BricksThatHaveNoUseForADraftHaveNone) {
    const Brick smooth = turbulent(SampleType::kFloat32, 8);
    EXPECT_EQ(smooth.encode(0.01, 0.1).draft_bytes, 0u) << "not exact";
    EXPECT_EQ(Brick(SampleType::kInt32, 8).fill(wave).encode(0, 1).draft_bytes, 0u);
    EXPECT_EQ(Brick(SampleType::kFloat32, 8).encode(0, 1).draft_bytes, 0u) << "one value";
    EXPECT_EQ(smooth.encode(0, 1e-9).draft_bytes, 0u) << "the draft would be as long as the whole";
    Brick infinite = smooth;
    infinite.set(5, 0x7f800000u);
    EXPECT_EQ(infinite.encode(0, 0.1).draft_bytes, 0u);
}

TEST(BrickDraftTest, ZeroStaysZeroInTheDraft) {
    const Brick brick = turbulent(SampleType::kFloat32, 16);
    const EncodedBrick encoded = brick.encode(0, 0.013);
    const auto draft = draftOf(brick, encoded);
    ASSERT_TRUE(draft) << draft.error().message;
    for (std::size_t i = 0; i < brick.count(); ++i) {
        if (brick.get(i) == 0) {
            ASSERT_EQ(brick.bitsAt(draft->values, i), 0u);
        }
    }
}

// Drafts of both kinds in front of every width; and exact payloads, which are no drafts.
std::vector<std::pair<Brick, EncodedBrick>> draftsToDamage() {
    std::vector<std::pair<Brick, EncodedBrick>> drafts;
    for (const double draft_error : {0.05, 1e3}) {
        for (const SampleType type : {SampleType::kFloat32, SampleType::kFloat64}) {
            Brick brick = turbulent(type, 8);
            brick.active.resize(brick.shape.cells());
            for (std::size_t i = 0; i < brick.active.size(); ++i) brick.active[i] = i % 7 == 0;
            drafts.emplace_back(brick, brick.encode(0, draft_error));
        }
        std::mt19937 random(29);
        const Brick halves = Brick(SampleType::kFloat32, 8).fill([&](int x, int, int, int) {
            return double(floatFromHalf(std::uint16_t(0x4800u + unsigned(x) * 64 + random() % 64)));
        });
        // Coarser: a draft of few noisy bits must stay below half of them to be kept.
        drafts.emplace_back(halves, halves.encode(0, 4 * draft_error));
    }
    return drafts;
}

void expectDraftDecodersSurvive(const Brick& brick, std::span<const std::byte> draft) {
    const std::vector<std::byte> exact(draft.begin(), draft.end());
    const auto decoded = decodeDraft(exact, brick.shape, brick.type, brick.components);
    std::vector<float> floats(brick.count());
    ASSERT_EQ(bool(decoded),
              bool(decodeDraftToFloat(exact, brick.shape, brick.type, brick.components, floats)));
    if (decoded) {
        ASSERT_EQ(decoded->values.size(), brick.values.size());
        for (const float value : floats) ASSERT_TRUE(std::isfinite(value));
    } else {
        EXPECT_EQ(decoded.error().code, ErrorCode::kCorrupt);
    }
}

// Payloads of every encoding and kind of states, small enough to damage at every byte.
std::vector<std::pair<Brick, std::vector<std::byte>>> payloadsToDamage() {
    std::vector<std::pair<Brick, std::vector<std::byte>>> payloads;
    for (const SampleType type :
         {SampleType::kFloat32, SampleType::kFloat64, SampleType::kInt32, SampleType::kBool})
        for (const double max_error : {0.0, 1e-3, 1e3}) {
            Brick brick =
                Brick(type, 8, type == SampleType::kFloat64 ? 3 : 1).fill([](int x, int y, int z, int) {
                    return x + y * 0.25 - (z == 3 ? 0.001 * x : 0);
                });
            brick.active.resize(brick.shape.cells());
            for (std::size_t i = 0; i < brick.active.size(); ++i) brick.active[i] = i % 7 == 0;
            payloads.emplace_back(brick, brick.encode(max_error).payload);
        }
    return payloads;
}

// Whatever the bytes are, both decoders agree whether they are a payload, and give a whole brick or an error.
void expectDecodersSurvive(const Brick& brick, std::span<const std::byte> payload) {
    // A buffer of exactly this size, so that a read past its end is caught by ASan, not by luck.
    const std::vector<std::byte> exact(payload.begin(), payload.end());
    const auto decoded = brick.decode(exact);
    std::vector<float> floats(brick.count());
    const auto as_floats = decodeBrickToFloat(exact, brick.shape, brick.type, brick.components, floats);
    if (decoded) {
        ASSERT_TRUE(as_floats);
        ASSERT_EQ(decoded->values.size(), brick.values.size());
        for (const float value : floats) ASSERT_TRUE(std::isfinite(value));
    } else {
        EXPECT_EQ(decoded.error().code, ErrorCode::kCorrupt);
        EXPECT_EQ(decoded.error().message.find('\n'), std::string::npos);
    }
}

TEST(BrickCodecTest, RefusesEveryTruncation) {
    for (const auto& [brick, payload] : payloadsToDamage())
        for (std::size_t size = 0; size < payload.size(); ++size) {
            const std::vector<std::byte> prefix(payload.begin(), payload.begin() + std::ptrdiff_t(size));
            ASSERT_FALSE(brick.decode(prefix))
                << "accepted the first " << size << " of " << payload.size() << " bytes";
            expectDecodersSurvive(brick, prefix);
        }
}

TEST(BrickCodecTest, SurvivesEveryFlippedByte) {
    for (const auto& [brick, payload] : payloadsToDamage())
        for (std::size_t at = 0; at < payload.size(); ++at)
            for (const unsigned flip : {0x01u, 0x40u, 0x80u, 0xffu}) {
                auto damaged = payload;
                damaged[at] ^= std::byte(std::uint8_t(flip));
                expectDecodersSurvive(brick, damaged);
            }
}

TEST(BrickDraftTest, RefusesEveryTruncationOfBothParts) {
    for (const auto& [brick, encoded] : draftsToDamage()) {
        ASSERT_GT(encoded.draft_bytes, 0u);
        const std::vector<std::byte>& payload = encoded.payload;
        for (std::size_t size = 0; size < payload.size(); ++size) {
            const std::vector<std::byte> prefix(payload.begin(), payload.begin() + std::ptrdiff_t(size));
            ASSERT_FALSE(brick.decode(prefix))
                << "accepted the first " << size << " of " << payload.size() << " bytes";
            ASSERT_EQ(bool(decodeDraft(prefix, brick.shape, brick.type, brick.components)),
                      size == encoded.draft_bytes)
                << "the first " << size << " bytes; the draft has " << encoded.draft_bytes;
            expectDecodersSurvive(brick, prefix);
            expectDraftDecodersSurvive(brick, prefix);
        }
        EXPECT_FALSE(decodeDraft(payload, brick.shape, brick.type, brick.components))
            << "more than the draft";
    }
}

TEST(BrickDraftTest, SurvivesEveryFlippedByteOfBothParts) {
    for (const auto& [brick, encoded] : draftsToDamage())
        for (std::size_t at = 0; at < encoded.payload.size(); ++at) {
            // Mantissa bytes are many and all alike: one kind of damage each.
            auto damaged = encoded.payload;
            damaged[at] ^= std::byte(std::uint8_t(1u << at % 8));
            expectDecodersSurvive(brick, damaged);
            expectDraftDecodersSurvive(brick, std::span(damaged).first(encoded.draft_bytes));
        }
}

TEST(BrickDraftTest, RefusesADraftThatIsNoneOrThatNothingCorrects) {
    const Brick brick = turbulent(SampleType::kFloat32, 8);
    const auto plain = brick.encode().payload, quantised = brick.encode(0.05).payload;
    const EncodedBrick drafted = brick.encode(0, 0.05);
    ASSERT_GT(drafted.draft_bytes, 0u);
    for (const auto& payload : {plain, quantised}) {
        const auto draft = decodeDraft(payload, brick.shape, brick.type, brick.components);
        ASSERT_FALSE(draft);
        EXPECT_THAT(draft.error().message, HasSubstr("without a draft"));
        // The same payload called a draft by its flag, with something else behind it.
        const auto cut = std::ptrdiff_t(drafted.draft_bytes);
        std::vector<std::byte> twice(drafted.payload.begin(), drafted.payload.begin() + cut);
        twice.insert(twice.end(), quantised.begin(), quantised.end());
        const auto decoded = brick.decode(twice);
        ASSERT_FALSE(decoded);
        EXPECT_THAT(decoded.error().message, HasSubstr("nothing corrects"));
    }
    auto lossless = plain;
    lossless[1] |= std::byte{0x80};
    EXPECT_FALSE(brick.decode(lossless)) << "a lossless draft";
    auto with_states = drafted.payload;
    with_states[4] = std::byte{1};
    EXPECT_FALSE(brick.decode(with_states)) << "states in the draft";
    auto no_number = brick.encode(0, 1e3);
    ASSERT_EQ(no_number.payload[1], std::byte{0x80});
    no_number.payload[7] = std::byte{0x80};
    no_number.payload[8] = std::byte{0x7f};
    EXPECT_FALSE(brick.decode(no_number.payload)) << "a draft that is infinite";
}

TEST(NearestHalfTest, RoundsToEvenAndSaturates) {
    // Every half is its own, and what lies between two goes to the nearer one, or to the even one.
    for (unsigned half = 0; half < 0x7bffu; ++half) {
        const float low = floatFromHalf(std::uint16_t(half)), high = floatFromHalf(std::uint16_t(half + 1));
        const float middle = low + (high - low) / 2;
        ASSERT_EQ(nearestHalf(low), half);
        ASSERT_EQ(nearestHalf(middle), half % 2 == 0 ? half : half + 1);
        ASSERT_EQ(nearestHalf(std::nextafter(middle, 0.0f)), half);
        ASSERT_EQ(nearestHalf(std::nextafter(middle, 1e9f)), half + 1);
        ASSERT_EQ(nearestHalf(-middle), nearestHalf(middle) | 0x8000u);
    }
    EXPECT_EQ(nearestHalf(65519.0f), 0x7bff);
    EXPECT_EQ(nearestHalf(3e38f), 0x7bff);
    EXPECT_EQ(nearestHalf(-3e38f), 0xfbff);
    EXPECT_EQ(nearestHalf(-0.0f), 0x8000);
    EXPECT_EQ(nearestHalf(1e-45f), 0);
}

TEST(BrickCodecTest, RefusesBytesBehindThePayload) {
    for (const auto& [brick, payload] : payloadsToDamage()) {
        auto longer = payload;
        longer.push_back(std::byte{0});
        EXPECT_FALSE(brick.decode(longer));
    }
}

TEST(BrickCodecTest, APayloadOfAnotherShapeOrTypeDoesNoHarm) {
    for (const auto& [brick, payload] : payloadsToDamage())
        for (const SampleType type : {SampleType::kFloat32, SampleType::kInt64, SampleType::kBool})
            for (const int edge : {8, 16}) expectDecodersSurvive(Brick(type, edge, 3), payload);
}

TEST(BrickCodecTest, RefusesAnotherVersionByItsNumber) {
    const Brick brick = Brick(SampleType::kFloat32, 8).fill(wave);
    auto payload = brick.encode().payload;
    payload[0] = std::byte{9};
    const auto decoded = brick.decode(payload);
    ASSERT_FALSE(decoded);
    EXPECT_THAT(decoded.error().message, HasSubstr("version 9"));
}

std::vector<std::byte> fromHex(const std::string& hex) {
    std::vector<std::byte> bytes;
    for (std::size_t i = 0; i + 1 < hex.size(); i += 2)
        bytes.push_back(std::byte(std::stoul(hex.substr(i, 2), nullptr, 16)));
    return bytes;
}

// Payloads written by the first version. They must decode for ever.
TEST(BrickCodecTest, OldPayloadsStillDecode) {
    struct Stored {
        double max_error;
        std::string hex;
    };
    const Stored stored[] = {
        // Halves with their differences; an activity mask.
        {0,
         "010102010421000080250000801400008028b52ffd60d901bd000050ff00ff000100ff00ff0004100063"
         "2a061108156b620128b52ffd60d901dd000080ff00700068006300780067006300680004500400612a08"
         "42050528b52ffd20405d000018fcfc000200a01122c002"},
        // Quantised to 8 bits with their differences; the same mask.
        {0.01,
         "0102010104f6285c8fc275943fceffffffffffffff210000801400008028b52ffd60d901bd0000506400"
         "32001a0063000100041000632ac6c4122a06110128b52ffd20405d000018fcfc000200a01122c002"},
        // A draft like the one before and its corrections.
        {0,
         "0182010100f6285c8fc275943fceffffffffffffff2100008028b52ffd60d901bd000050640032001a0063000100"
         "041000632ac6c4122a061101010102000443000080010000001400008028b52ffd60d901cd0100500000044f4f25"
         "0326265015001754a8300a1080000036e1cc012d4000a0414000680002000d02024003100034b804124000386cb2"
         "108081210028b52ffd20405d000018fcfc000200a01122c002"},
        // One value.
        {1e3, "0100000004000000001400008028b52ffd20405d000018fcfc000200a01122c002"},
    };
    Brick brick = Brick(SampleType::kFloat32, 8).fill([](int x, int y, int z, int) {
        return (x >= 2 ? 0.5 : 0) + (y >= 5 ? 0.25 : 0) - (z >= 4 ? 1 : 0);
    });
    brick.active.resize(brick.shape.cells());
    for (std::size_t i = 0; i < brick.active.size(); ++i) brick.active[i] = i % 8 >= 2 && i < 256;
    for (const auto& [max_error, hex] : stored) {
        const auto decoded = brick.decode(fromHex(hex));
        ASSERT_TRUE(decoded) << decoded.error().message;
        EXPECT_TRUE(decoded->active == brick.active);
        for (std::size_t i = 0; i < brick.count(); ++i)
            ASSERT_NEAR(toDouble(brick.type, brick.bitsAt(decoded->values, i)),
                        toDouble(brick.type, brick.get(i)), max_error);
    }
}

}  // namespace
}  // namespace brickyard
