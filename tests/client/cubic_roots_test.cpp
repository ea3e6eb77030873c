#include "client/trace/cubic_roots.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace brickyard {
namespace {

using Powers = std::array<long double, 4>;

Powers powersOf(const Cubic& cubic) {
    const long double b0 = cubic.control[0], b1 = cubic.control[1], b2 = cubic.control[2],
                      b3 = cubic.control[3];
    return {b0, 3 * (b1 - b0), 3 * (b0 - 2 * b1 + b2), (b3 - b0) + 3 * (b1 - b2)};
}
long double valueAt(const Powers& c, long double s) { return c[0] + s * (c[1] + s * (c[2] + s * c[3])); }
long double largestOf(const Cubic& cubic) {
    long double most = 0;
    for (double b : cubic.control) most = std::max(most, std::abs((long double)b));
    return most;
}

// Sturm's chain, highest power first, and the number of distinct roots in (0, 1].
int sturmCount(const Powers& c) {
    std::vector<std::vector<long double>> chain(2);
    for (int i = 3; i >= 0; --i) chain[0].push_back(c[std::size_t(i)]);
    auto trim = [](std::vector<long double>& p, long double zero) {
        while (!p.empty() && std::abs(p.front()) <= zero) p.erase(p.begin());
    };
    long double size = 0;
    for (long double v : c) size = std::max(size, std::abs(v));
    trim(chain[0], size * 1e-17L);
    for (std::size_t i = 0; i + 1 < chain[0].size(); ++i)
        chain[1].push_back(chain[0][i] * (long double)(chain[0].size() - 1 - i));
    while (!chain.back().empty()) {
        std::vector<long double> rest = chain[chain.size() - 2];
        const std::vector<long double>& by = chain.back();
        long double most = 0;
        for (long double v : rest) most = std::max(most, std::abs(v));
        while (rest.size() >= by.size()) {
            const long double factor = rest.front() / by.front();
            for (std::size_t i = 0; i < by.size(); ++i) rest[i] -= factor * by[i];
            rest.erase(rest.begin());
        }
        trim(rest, most * 1e-17L);
        for (long double& v : rest) v = -v;
        chain.push_back(std::move(rest));
    }
    auto changesAt = [&](long double s) {
        int changes = 0;
        long double before = 0;
        for (const std::vector<long double>& p : chain) {
            long double value = 0;
            for (long double v : p) value = value * s + v;
            if (value == 0) continue;
            changes += before != 0 && (before > 0) != (value > 0);
            before = value;
        }
        return changes;
    };
    return changesAt(0) - changesAt(1);
}

// Least magnitude of the cubic at its ends and at its extrema in [0, 1]: where that is a rounding, so is the
// number of roots.
long double clearance(const Powers& c) {
    long double least = std::min(std::abs(valueAt(c, 0)), std::abs(valueAt(c, 1)));
    const long double discriminant = c[2] * c[2] - 3 * c[1] * c[3];
    std::vector<long double> extrema;
    if (c[3] == 0) {
        if (c[2] != 0) extrema = {-c[1] / (2 * c[2])};
    } else if (discriminant >= 0) {
        const long double q = -(c[2] + std::copysign(std::sqrt(discriminant), c[2]));
        extrema = {q / (3 * c[3])};
        if (q != 0) extrema.push_back(c[1] / q);
    }
    for (long double s : extrema)
        if (s >= -1e-6L && s <= 1 + 1e-6L) least = std::min(least, std::abs(valueAt(c, s)));
    return least;
}

void check(const Cubic& cubic) {
    SCOPED_TRACE(testing::Message() << "control points " << cubic.control[0] << " " << cubic.control[1] << " "
                                    << cubic.control[2] << " " << cubic.control[3]);
    const Powers powers = powersOf(cubic);
    const long double size = largestOf(cubic);
    const CubicRoots changes = signChanges(cubic), roots = realRoots(cubic);
    EXPECT_EQ(changes.count % 2 == 1, (cubic.control[0] > 0) != (cubic.control[3] > 0));
    for (const CubicRoots* found : {&changes, &roots})
        for (std::size_t i = 0; i < std::size_t(found->count); ++i) {
            EXPECT_GE(found->at[i], 0);
            EXPECT_LE(found->at[i], 1);
            if (i > 0) {
                EXPECT_GE(found->at[i], found->at[i - 1]);
            }
            // Backward stable: a root of a cubic whose control points are off by a few roundings.
            EXPECT_LE(std::abs(valueAt(powers, found->at[i])), 2e-15L * size) << "at " << found->at[i];
        }
    if (clearance(powers) <= 1e-13L * size) return;
    const int exact = sturmCount(powers);
    EXPECT_EQ(changes.count, exact);
    EXPECT_EQ(roots.count, exact);
}

TEST(CubicRootsTest, AgreeWithSturmOnAllSmallIntegers) {
    for (int a = -5; a <= 5; ++a)
        for (int b = -5; b <= 5; ++b)
            for (int c = -5; c <= 5; ++c)
                for (int d = -5; d <= 5; ++d) check({{double(a), double(b), double(c), double(d)}});
}

TEST(CubicRootsTest, AgreeWithSturmOnRandomControlPoints) {
    std::mt19937_64 random(1);
    std::uniform_real_distribution<double> unit(-1, 1), exponent(-40, 0);
    for (int trial = 0; trial < 400000; ++trial) {
        Cubic cubic;
        for (double& b : cubic.control) {
            b = unit(random);
            // Coefficients of very different size, and some that vanish.
            if (trial % 3 == 1) b *= std::exp2(exponent(random));
            if (trial % 3 == 2 && unit(random) > 0.5) b = 0;
        }
        check(cubic);
    }
}

TEST(CubicRootsTest, FindRootsWhereTheyWerePut) {
    std::mt19937_64 random(2);
    std::uniform_real_distribution<double> unit(0, 1);
    for (int trial = 0; trial < 100000; ++trial) {
        double r[3] = {unit(random), unit(random), unit(random)};
        if (trial % 2) r[2] += 1.5;
        if (trial % 4 == 3) r[1] -= 1.5;
        std::sort(std::begin(r), std::end(r));
        const double k = trial % 5 ? 1 : -1;
        const Cubic cubic =
            Cubic::fromPowers(-k * r[0] * r[1] * r[2], k * (r[0] * r[1] + r[0] * r[2] + r[1] * r[2]),
                              -k * (r[0] + r[1] + r[2]), k);
        const double apart = std::min(r[1] - r[0], r[2] - r[1]);
        if (apart < 1e-3) continue;
        std::vector<double> expected;
        for (double s : r)
            if (s > 0 && s < 1) expected.push_back(s);
        const CubicRoots found = signChanges(cubic);
        ASSERT_EQ(found.count, int(expected.size())) << r[0] << " " << r[1] << " " << r[2];
        for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(found.at[i], expected[i], 1e-9);
    }
}

TEST(CubicRootsTest, FindTouchesAndDegenerateCubics) {
    auto expectRoots = [](const Cubic& cubic, std::vector<double> expected, double tolerance) {
        const CubicRoots found = realRoots(cubic);
        ASSERT_EQ(found.count, int(expected.size())) << cubic.control[0] << " " << cubic.control[3];
        for (std::size_t i = 0; i < expected.size(); ++i) EXPECT_NEAR(found.at[i], expected[i], tolerance);
    };
    expectRoots(Cubic::fromPowers(0.0625, -0.5, 1, 0), {0.25}, 1e-8);         // (s - 1/4)^2
    expectRoots(Cubic::fromPowers(-0.125, 0.75, -1.5, 1), {0.5}, 1e-5);       // (s - 1/2)^3
    expectRoots(Cubic::fromPowers(0.125, -0.4375, 0.25, 0.25), {0.5}, 1e-7);  // not monotone; a double root
    expectRoots(Cubic::fromPowers(1, -4, 0, 0), {0.25}, 1e-15);               // a line
    expectRoots(Cubic::fromPowers(2, -9, 9, 0), {1.0 / 3, 2.0 / 3}, 1e-14);   // a parabola
    expectRoots(Cubic::fromPowers(0, 0, 0, 0), {0}, 0);
    expectRoots(Cubic::fromPowers(3, 0, 0, 0), {}, 0);
    expectRoots(Cubic::fromPowers(0, 1, 0, 0), {0}, 0);
    expectRoots(Cubic::fromPowers(-1, 1, 0, 0), {1}, 0);
    for (double size : {1e-320, 1e-300, 1e-150, 1e150, 1e300}) {
        const Cubic cubic{{-size, 3 * size, -3 * size, size}};
        EXPECT_EQ(signChanges(cubic).count, 3) << size;
        EXPECT_NEAR(signChanges(cubic).at[1], 0.5, 1e-3) << size;
    }
    // A root beside the begin of a cell.
    EXPECT_NEAR(signChanges({{1e-30, -1, -1, -1}}).at[0], 1e-30 / 3, 1e-16);
    EXPECT_EQ(signChanges({{0, 0, 0, 1}}).count, 1);
    EXPECT_EQ(signChanges({{0, 0, 0, 0}}).count, 0);
    EXPECT_EQ(signChanges({{0, -1, -1, 0}}).count, 0) << "0 is not positive";
}

TEST(CubicTest, GoesThroughItsValues) {
    const Cubic cubic = Cubic::through(1, -2, 5, 0.5);
    EXPECT_EQ(cubic.at(0), 1);
    EXPECT_NEAR(cubic.at(1.0 / 3), -2, 1e-14);
    EXPECT_NEAR(cubic.at(2.0 / 3), 5, 1e-14);
    EXPECT_EQ(cubic.at(1), 0.5);
}

}  // namespace
}  // namespace brickyard
