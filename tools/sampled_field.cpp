#include "tools/sampled_field.h"

#include <algorithm>
#include <cmath>
#include <glm/common.hpp>
#include <glm/geometric.hpp>

#include "tools/field_walk.h"

namespace brickyard {

Result<SampledField> SampledField::read(const FieldReader& reader, std::uint64_t most_samples, int finest) {
    SampledField field;
    field.index_to_world_ = reader.indexToWorld();
    for (const ValueBits bits : reader.background())
        field.background_.push_back(toFloat(reader.type(), bits));
    const ChannelFooter& channel = reader.channel();
    if (channel.active_voxels() == 0 || channel.active_min_size() != 3) return field;

    IndexBox active;
    for (int a = 0; a < 3; ++a) {
        active.begin[std::size_t(a)] = channel.active_min(a);
        active.end[std::size_t(a)] = std::int64_t(channel.active_max(a)) + 1;
    }
    for (field.level_ = finest;; ++field.level_) {
        const std::int64_t edge = std::int64_t(1) << field.level_;
        for (std::size_t a = 0; a < 3; ++a) {
            const std::int64_t low = active.begin[a], high = active.end[a] - 1;
            // Rounded down, also below 0.
            field.box_.begin[a] = (low >> field.level_) - 1;
            field.box_.end[a] = (high >> field.level_) + (high % edge != 0 ? 1 : 0) + 2;
        }
        const double samples = double(field.size(0)) * double(field.size(1)) * double(field.size(2));
        if (samples <= double(most_samples) || field.level_ == kMaxLevel) break;
    }
    SampleBlock block;
    if (auto read = readLevel(reader, field.level_, field.box_, block); !read)
        return tl::unexpected(read.error());
    const SampleType type = walkedType(reader.type(), field.level_);
    const std::size_t count = std::size_t(field.count()) * std::size_t(reader.components());
    field.values_.reserve(count);
    for (std::size_t i = 0; i < count; ++i)
        field.values_.push_back(toFloat(type, sampleBits(type, block.values, i)));
    return field;
}

glm::dvec3 SampledField::world(std::int64_t at) const {
    const std::int64_t x = at % size(0), y = at / size(0) % size(1), z = at / size(0) / size(1);
    const glm::dvec3 place(double(box_.begin[0] + x), double(box_.begin[1] + y), double(box_.begin[2] + z));
    return index_to_world_.point(std::ldexp(1.0, level_) * place);
}

double SampledField::spacing(int axis) const {
    glm::dvec3 step(0);
    step[axis] = std::ldexp(1.0, level_);
    return glm::length(index_to_world_.vector(step));
}

double SampledField::at(const glm::dvec3& world, int component) const {
    glm::dvec3 place = std::ldexp(1.0, -level_) * index_to_world_.inversePoint(world);
    std::int64_t low[3];
    for (int a = 0; a < 3; ++a) {
        place[a] -= double(box_.begin[std::size_t(a)]);
        if (!(place[a] >= 0 && place[a] <= double(size(a) - 1)))
            return double(background_[std::size_t(component)]);
        low[a] = std::min(std::int64_t(place[a]), size(a) - 2);
        place[a] -= double(low[a]);
    }
    double sum = 0;
    for (int corner = 0; corner < 8; ++corner) {
        double weight = 1;
        std::int64_t index = 0;
        for (int a = 2; a >= 0; --a) {
            const int high = corner >> a & 1;
            weight *= high ? place[a] : 1 - place[a];
            index = index * size(a) + low[a] + high;
        }
        sum += weight * double(value(index, component));
    }
    return sum;
}

glm::dvec3 SampledField::vectorAt(const glm::dvec3& world) const {
    return {at(world, 0), at(world, 1), at(world, 2)};
}

double SampledField::quantile(double part) const {
    if (empty()) return 0;
    std::vector<float> sorted(values_.begin(), values_.begin() + count());
    const auto place = sorted.begin() + std::ptrdiff_t(part * double(sorted.size() - 1));
    std::nth_element(sorted.begin(), place, sorted.end());
    return double(*place);
}

}  // namespace brickyard
