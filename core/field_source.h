// One channel of one frame as the octree builder sees it: a field of samples on all of the int32 lattice.
// Importers implement it over their format; tests over formulas. Const members may be called from any thread.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/affine.h"
#include "core/index_box.h"
#include "core/result.h"
#include "core/sample_type.h"

namespace brickyard {

// A note that the source keeps beside its samples, carried through unread. `type` is OpenVDB's word
// ("string", "float", "vec3s"), `value` the bytes as OpenVDB serialises them, without their length.
struct MetadataEntry {
    std::string name, type, value;
};

// What a channel is, beside its samples.
struct ChannelInfo {
    std::string name;  // UTF-8
    SampleType type = SampleType::kFloat32;
    int components = 1;                    // 1 or 3
    std::vector<ValueBits> background{0};  // one per component
    Affine index_to_world;
    // Tight, half-open box of the active voxels; empty when there are none.
    IndexBox active_box;
    std::uint64_t active_voxels = 0;
    std::string grid_class = "unknown";  // OpenVDB's words
    std::string vector_type;
    bool saved_as_half = false;
    // The source's own type where `type` is wider than it ("uint16", or "mask" for states without values);
    // else empty.
    std::string source_type;
    std::vector<MetadataEntry> metadata;  // in the source's order
};

// All samples of a box: `values` component by component (planar), each x fastest, `sampleBytes(type)` a
// sample; `active` one byte per sample, 0 or 1, x fastest.
struct SampleBlock {
    std::vector<std::byte> values;
    std::vector<std::uint8_t> active;
};

// Every sample of a region has this value and this state.
struct UniformRegion {
    std::vector<ValueBits> value;  // one per component
    bool active = false;
};

class FieldSource {
public:
    virtual ~FieldSource() = default;

    virtual const ChannelInfo& info() const = 0;

    // The one value and state that every sample of `box` has, or nothing where they differ or where that is
    // not known without reading samples. Must be cheap: it is asked top-down, from boxes of 2^32 samples an
    // edge to single bricks. Positions outside int32 are inactive background. Errors of the source are
    // read()'s to tell.
    virtual std::optional<UniformRegion> uniformOver(const IndexBox& box) const = 0;

    // The samples of `box`, which has at most 2^24. Errors: whatever reading the source can meet, with file
    // and grid.
    virtual Result<void> read(const IndexBox& box, SampleBlock& out) const = 0;

    // True where boxes that follow each other along x, then y, then z are read faster than in any other order
    // (a dump).
    virtual bool prefersRows() const { return false; }
    // Nothing will be asked for a while: what is kept for speed may go. Not while another thread reads.
    virtual void release() const {}
};

}  // namespace brickyard
