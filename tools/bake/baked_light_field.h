// Transmittance to one light as a channel: sampled where the medium is, 1 and inactive elsewhere.
#pragma once

#include <mutex>
#include <string>

#include "core/affine.h"
#include "core/field_source.h"
#include "tools/bake/light_sampler.h"
#include "tools/bake/lit_voxels.h"

namespace brickyard {

class BakedLightField final : public FieldSource {
public:
    // `voxels` outlives it, and has been counted. `stored`: the density's transform as the file has it, which
    // the channel gets, scaled to the voxels' level. `bound`: the same where the scene has moved it, which
    // places the samples in the world.
    BakedLightField(std::string name, const LitVoxels& voxels, const Affine& stored, const Affine& bound,
                    LightSampler sampler);

    const ChannelInfo& info() const override { return info_; }
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override;
    Result<void> read(const IndexBox& box, SampleBlock& out) const override;

private:
    const LitVoxels& voxels_;
    ChannelInfo info_;
    Affine to_world_;  // from level-0 index space
    LightSampler sampler_;
    mutable std::mutex mutex_;  // the sampler is one thread's at a time
};

}  // namespace brickyard
