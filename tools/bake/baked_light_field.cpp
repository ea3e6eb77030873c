#include "tools/bake/baked_light_field.h"

#include <bit>
#include <cmath>
#include <cstring>

namespace brickyard {

namespace {

// Voxels of a level: from the same origin, 2^level times as wide.
Affine scaled(const Affine& transform, int level) {
    std::array<double, 16> columns{};
    for (int c = 0; c < 4; ++c)
        for (int r = 0; r < 4; ++r)
            columns[std::size_t(4 * c + r)] =
                transform.matrix()[c][r] * (c < 3 ? std::ldexp(1.0, level) : 1.0);
    // A power of two: what could be inverted still can, within the levels there are.
    const Result<Affine> affine = Affine::fromColumns(columns);
    return affine ? *affine : transform;
}

}  // namespace

BakedLightField::BakedLightField(std::string name, const LitVoxels& voxels, const Affine& stored,
                                 const Affine& bound, LightSampler sampler)
    : voxels_(voxels), to_world_(bound), sampler_(std::move(sampler)) {
    info_.name = std::move(name);
    info_.background = {std::bit_cast<std::uint32_t>(1.0f)};
    info_.index_to_world = scaled(stored, voxels.level());
    info_.active_box = voxels.box();
    info_.active_voxels = voxels.voxels();
}

std::optional<UniformRegion> BakedLightField::uniformOver(const IndexBox& box) const {
    const IndexBox inside = intersect(box, voxels_.box());
    if (inside.empty() || !voxels_.anyIn(inside)) return UniformRegion{info_.background, false};
    return std::nullopt;
}

Result<void> BakedLightField::read(const IndexBox& box, SampleBlock& out) const {
    if (Result<void> masked = voxels_.mask(box, out.active); !masked) return masked;
    std::vector<glm::dvec3> points;
    std::vector<std::size_t> places;
    const double edge = std::ldexp(1.0, voxels_.level());
    std::size_t at = 0;
    for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
        for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y)
            for (std::int64_t x = box.begin[0]; x < box.end[0]; ++x, ++at)
                if (out.active[at]) {
                    points.push_back(to_world_.point(edge * glm::dvec3(double(x), double(y), double(z))));
                    places.push_back(at);
                }
    std::vector<float> lit(points.size());
    if (!points.empty()) {
        const std::lock_guard lock(mutex_);
        if (Result<void> sampled = sampler_(points, lit); !sampled) return sampled;
    }
    std::vector<float> values(out.active.size(), 1.0f);
    for (std::size_t i = 0; i < places.size(); ++i) values[places[i]] = lit[i];
    out.values.resize(values.size() * sizeof(float));
    std::memcpy(out.values.data(), values.data(), out.values.size());
    return {};
}

}  // namespace brickyard
