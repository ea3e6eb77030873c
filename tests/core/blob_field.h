// Fields with known answers for tests of the octree: sums of smooth and rough blobs, constant boxes, other
// types. Values come from a formula at each integer position; nothing is stored.
#pragma once

#include <bit>
#include <cmath>
#include <cstring>
#include <functional>

#include "core/field_source.h"

namespace brickyard {

// `value(x, y, z)` inside `box`, background outside; active inside the box where `value` is not the
// background.
class FormulaField final : public FieldSource {
public:
    using Formula = std::function<double(std::int64_t, std::int64_t, std::int64_t, int component)>;
    FormulaField(std::string name, IndexBox box, Formula formula, SampleType type = SampleType::kFloat32,
                 int components = 1, double background = 0)
        : box_(box), formula_(std::move(formula)), background_(background) {
        info_.name = std::move(name);
        info_.type = type;
        info_.components = components;
        info_.background.assign(std::size_t(components), bits(background));
        background_ = toDouble(type, info_.background[0]);
        info_.active_box = box;
        info_.active_voxels =
            std::uint64_t(box.extent(0)) * std::uint64_t(box.extent(1)) * std::uint64_t(box.extent(2));
    }
    void setTransform(const Affine& transform) { info_.index_to_world = transform; }

    ValueBits bits(double value) const {
        if (info_.type == SampleType::kFloat32) return std::bit_cast<std::uint32_t>(float(value));
        return fromDouble(info_.type, value);
    }
    // As stored: rounded to the sample type.
    double at(std::int64_t x, std::int64_t y, std::int64_t z, int component = 0) const {
        if (!box_.contains({x, y, z})) return background_;
        return toDouble(info_.type, bits(formula_(x, y, z, component)));
    }
    const ChannelInfo& info() const override { return info_; }
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override {
        UniformRegion background{info_.background, false};
        const IndexBox inside = intersect(box, box_);
        if (inside.empty()) return background;
        // Small boxes are looked at sample by sample, so that flat parts of a formula become regions of one
        // value.
        if (box.extent(0) > 130) return std::nullopt;
        UniformRegion first;
        bool have = false;
        for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
            for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y)
                for (std::int64_t x = box.begin[0]; x < box.end[0]; ++x) {
                    UniformRegion here;
                    for (int c = 0; c < info_.components; ++c) here.value.push_back(bits(at(x, y, z, c)));
                    here.active = box_.contains({x, y, z});
                    if (have && (here.value != first.value || here.active != first.active))
                        return std::nullopt;
                    first = here;
                    have = true;
                }
        return first;
    }
    Result<void> read(const IndexBox& box, SampleBlock& out) const override {
        out.values.clear();
        out.active.clear();
        const std::size_t bytes = sampleBytes(info_.type);
        for (int c = 0; c < info_.components; ++c)
            for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
                for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y)
                    for (std::int64_t x = box.begin[0]; x < box.end[0]; ++x) {
                        const ValueBits value = bits(at(x, y, z, c));
                        std::byte raw[8];
                        std::memcpy(raw, &value, sizeof raw);
                        out.values.insert(out.values.end(), raw, raw + bytes);
                        if (c == 0) out.active.push_back(box_.contains({x, y, z}));
                    }
        return {};
    }

private:
    IndexBox box_;
    Formula formula_;
    double background_;
    ChannelInfo info_;
};

// Smooth on a large scale, rough on a small one, never negative.
inline double roughBlob(double x, double y, double z) {
    const double r2 = (x * x + y * y + z * z) / 900;
    return std::max(
        0.0, std::exp(-r2) * (1 + 0.4 * std::sin(1.3 * x + 0.7 * y) * std::sin(0.9 * z - 0.5 * x)) - 0.05);
}

inline FormulaField roughBlobField(IndexBox box = {{-30, -25, -20}, {31, 26, 37}}) {
    return FormulaField("density", box, [](std::int64_t x, std::int64_t y, std::int64_t z, int c) {
        return roughBlob(double(x), double(y), double(z)) * (c + 1);
    });
}

}  // namespace brickyard
