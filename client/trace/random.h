// Random numbers of a path: the same for the same pixel and sample, whatever the thread. Plain value.
// O'Neill. PCG: A Family of Simple Fast Space-Efficient Statistically Good Algorithms. 2014.
#pragma once

#include <cstdint>

namespace brickyard {

inline std::uint64_t mixBits(std::uint64_t h) {
    h = (h ^ (h >> 30)) * 0xbf58476d1ce4e5b9ull;
    h = (h ^ (h >> 27)) * 0x94d049bb133111ebull;
    return h ^ (h >> 31);
}

class PathRandom {
public:
    PathRandom(std::uint64_t seed, std::uint64_t pixel, std::uint64_t sample)
        : increment_(mixBits(mixBits(seed + 0x9e3779b97f4a7c15ull) ^ pixel) | 1) {
        state_ = mixBits(increment_ + mixBits(sample + 0x632be59bd9b4e019ull));
        bits();
    }
    // Uniform in [0, 1).
    double uniform() {
        // One after the other: the order within an expression is the compiler's.
        const double high = double(bits()) * 0x1p-32;
        return high + double(bits() >> 11) * 0x1p-53;
    }

private:
    std::uint32_t bits() {
        const std::uint64_t old = state_;
        state_ = old * 6364136223846793005ull + increment_;
        const std::uint32_t shifted = std::uint32_t(((old >> 18) ^ old) >> 27);
        const std::uint32_t turn = std::uint32_t(old >> 59);
        return (shifted >> turn) | (shifted << ((32 - turn) & 31));
    }
    std::uint64_t state_ = 0, increment_ = 1;
};

}  // namespace brickyard
