// A field with its NaN and infinite values refused or replaced, as the user asked (`--nonfinite`).
// A view: `source` outlives it. As thread-safe as its source.
#pragma once

#include "core/field_source.h"
#include "core/octree_builder.h"

namespace brickyard {

class FiniteField final : public FieldSource {
public:
    // kReject: read() fails at the first value that is not finite, and create() where the background is not.
    // kZero: all become 0. kClamp: NaN becomes 0, infinities the type's largest finite value of their sign.
    // Errors: kInvalid.
    static Result<FiniteField> create(const FieldSource& source, NonFinite policy);

    const ChannelInfo& info() const override { return info_; }
    // Under kReject a region of one value may come back not finite: whoever asks refuses it (see
    // refuseNonFinite).
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override;
    Result<void> read(const IndexBox& box, SampleBlock& out) const override;

private:
    FiniteField(const FieldSource& source, NonFinite policy)
        : source_(&source), policy_(policy), info_(source.info()) {}
    const FieldSource* source_;
    NonFinite policy_;
    ChannelInfo info_;
};

// Error that names a voxel whose value is not finite and what to do.
tl::unexpected<Error> refuseNonFinite(const ChannelInfo& channel, const Index3& voxel);

}  // namespace brickyard
