// What our brick codec is measured against: zfp, Blosc and zstd by themselves, over the same samples. The
// only file that sees their headers is codec_peers.cpp. Const members may be called from any thread, one at a
// time.
#pragma once

#include <cstddef>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

namespace brickyard {

// Samples of one brick: a cube of edge^3, x fastest, for each component; planar.
struct CodecShape {
    int edge_samples = 17;
    int components = 1;
    std::size_t samples() const {
        const std::size_t edge = std::size_t(edge_samples);
        return edge * edge * edge * std::size_t(components);
    }
};

class SampleCodec {
public:
    virtual ~SampleCodec() = default;
    // `out` is replaced. REQUIRES: shape.samples() finite values.
    virtual void encode(std::span<const float> values, std::vector<std::byte>& out) const = 0;
    // What encode() made. False where the library refuses it. `out` has shape.samples() values.
    virtual bool decode(std::span<const std::byte> bytes, std::span<float> out) const = 0;
    // How many values of a brick are coded; the others are left as they are.
    virtual std::size_t codedSamples() const = 0;
};

// `tolerance_exponent`: errors of at most 2^it (zfp rounds a tolerance down to a power of two); without one
// it is lossless. Without `last_face` only the first edge - 1 samples along each axis are coded: zfp works on
// blocks of 4^3, and fills up what is left of one.
std::unique_ptr<SampleCodec> makeZfpCodec(const CodecShape& shape, std::optional<int> tolerance_exponent,
                                          bool last_face);

// Values on a grid: the nearest of first + step * k, as words of 16 bits where those suffice, else of 32.
struct WordGrid {
    double first = 0, step = 1;
    bool narrow = true;
};

// Bytes of floats, or of words where a grid is given. Blosc transposes bytes and is on one thread.
std::unique_ptr<SampleCodec> makeBloscCodec(const CodecShape& shape, std::optional<WordGrid> grid,
                                            const std::string& compressor, int level);
std::unique_ptr<SampleCodec> makeZstdCodec(const CodecShape& shape, std::optional<WordGrid> grid, int level);

}  // namespace brickyard
