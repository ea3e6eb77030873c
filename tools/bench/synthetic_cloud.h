// A cloud as no file of ours holds one: large, sparse, with detail at every scale. Billows of fractal value
// noise (Perlin and Hoffert, Hypertexture, 1989) in a few round envelopes; a formula, so the same everywhere.
// Any thread once made.
#pragma once

#include <filesystem>
#include <vector>

#include "core/field_source.h"
#include "core/octree_builder.h"

namespace brickyard {

class SyntheticCloud final : public FieldSource {
public:
    // Fills a part of the box [0, edge)^3, one world unit wide. REQUIRES: `edge` is a multiple of 16, at most
    // 2048. Looks at every sample that could be dense, once.
    SyntheticCloud(int edge, const ParallelFor& parallel_for);

    const ChannelInfo& info() const override { return info_; }
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override;
    Result<void> read(const IndexBox& box, SampleBlock& out) const override;

private:
    float at(std::int64_t x, std::int64_t y, std::int64_t z) const;
    double envelope(double x, double y, double z) const;
    double noise(double x, double y, double z) const;
    struct Tile {
        std::uint32_t dense = 0;  // samples
        IndexBox box;             // tight
    };
    Tile look(int tx, int ty, int tz) const;
    // The tile's place; tiles of 16^3 samples, x fastest.
    std::size_t tileAt(std::int64_t tx, std::int64_t ty, std::int64_t tz) const {
        return std::size_t(tx + tiles_ * (ty + tiles_ * tz));
    }

    int edge_, tiles_;
    ChannelInfo info_;
    std::vector<float> lattice_;          // random values in [0, 1), kLattice^3, periodic
    std::vector<std::uint8_t> occupied_;  // by tile
};

// Frame 0 of a new dataset at `folder`: a cloud in a channel "density", with bricks of the default edge.
// Errors: those of writing.
Result<void> storeSyntheticCloud(int edge, const std::filesystem::path& folder);

}  // namespace brickyard
