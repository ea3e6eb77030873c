// Where light is baked: the voxels of a level that a medium's field reaches. Those are the lattice points
// within one voxel (of the level) of a density sample that is active, or above 0 inside the medium. Immutable
// once counted: any thread.
#pragma once

#include <cstdint>
#include <vector>

#include "core/field_source.h"
#include "core/index_box.h"
#include "tools/field_reader.h"

namespace brickyard {

class LitVoxels {
public:
    // `density` outlives it. REQUIRES: 0 <= level <= kMaxBakeLevel.
    LitVoxels(const FieldReader& density, int level);

    // Looks at all of them. Errors: those of FieldReader::read.
    Result<void> count();
    // Tight. REQUIRES: count() was successful.
    const IndexBox& box() const { return box_; }
    std::uint64_t voxels() const { return voxels_; }
    int level() const { return level_; }
    const FieldReader& density() const { return density_; }

    // One byte a voxel of `box` (in voxels of the level), x fastest. Errors: those of FieldReader::read.
    Result<void> mask(const IndexBox& box, std::vector<std::uint8_t>& out) const;
    // False where none of the box is lit, as far as the tree tells. Cheap.
    bool anyIn(const IndexBox& box) const;

private:
    IndexBox reach(const IndexBox& box) const;
    bool maySet(const FieldNode& node, const IndexBox& box) const;
    Result<void> maskPiece(const IndexBox& piece, std::vector<std::uint8_t>& out) const;

    const FieldReader& density_;
    int level_;
    IndexBox medium_;  // level-0 samples that count: the active box and one beyond
    bool background_counts_ = false;
    IndexBox box_;
    std::uint64_t voxels_ = 0;
};

inline constexpr int kMaxBakeLevel = 6;

}  // namespace brickyard
