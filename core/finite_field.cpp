#include "core/finite_field.h"

#include <fmt/format.h>

#include <cmath>
#include <cstring>
#include <limits>

#include "core/vector_clones.h"

namespace brickyard {

namespace {

template <class T>
T finiteOf(T value, NonFinite policy) {
    if (policy == NonFinite::kZero || std::isnan(value)) return T(0);
    return std::copysign(std::numeric_limits<T>::max(), value);
}

constexpr std::size_t kRun = 256;

// Whether kRun values are finite: none has an exponent of ones only.
BRICKYARD_VECTOR_CLONES
bool allFinite(const float* values) {
    bool finite = true;
    for (std::size_t i = 0; i < kRun; ++i) finite &= std::abs(values[i]) <= std::numeric_limits<float>::max();
    return finite;
}
BRICKYARD_VECTOR_CLONES
bool allFinite(const double* values) {
    bool finite = true;
    for (std::size_t i = 0; i < kRun; ++i)
        finite &= std::abs(values[i]) <= std::numeric_limits<double>::max();
    return finite;
}

// The index of the first value that is not finite, or n; with a policy that replaces, replaces all and gives
// n.
template <class T>
std::size_t scan(std::vector<std::byte>& bytes, NonFinite policy) {
    const std::size_t n = bytes.size() / sizeof(T);
    for (std::size_t i = 0; i < n; ++i) {
        // All values are looked at, and hardly ever is one not finite: many at a time.
        if (i % kRun == 0)
            while (i + kRun <= n && allFinite(reinterpret_cast<const T*>(bytes.data()) + i)) i += kRun;
        if (i >= n) break;
        T value;
        std::memcpy(&value, bytes.data() + i * sizeof(T), sizeof(T));
        if (std::isfinite(value)) continue;
        if (policy == NonFinite::kReject) return i;
        value = finiteOf(value, policy);
        std::memcpy(bytes.data() + i * sizeof(T), &value, sizeof(T));
    }
    return n;
}

ValueBits finiteBits(SampleType type, ValueBits bits, NonFinite policy) {
    const double value = toDouble(type, bits);
    if (std::isfinite(value)) return bits;
    if (type == SampleType::kFloat32) {
        const float replaced = finiteOf(float(value), policy);
        std::uint32_t out;
        std::memcpy(&out, &replaced, sizeof out);
        return out;
    }
    return fromDouble(type, finiteOf(value, policy));
}

}  // namespace

Result<FiniteField> FiniteField::create(const FieldSource& source, NonFinite policy) {
    FiniteField field(source, policy);
    for (ValueBits& bits : field.info_.background) {
        const double value = toDouble(field.info_.type, bits);
        if (std::isfinite(value)) continue;
        if (policy == NonFinite::kReject)
            return fail(ErrorCode::kInvalid,
                        fmt::format("channel '{}': its background is {}; convert with --nonfinite zero "
                                    "or clamp to replace it",
                                    field.info_.name, value));
        bits = finiteBits(field.info_.type, bits, policy);
    }
    return field;
}

std::optional<UniformRegion> FiniteField::uniformOver(const IndexBox& box) const {
    std::optional<UniformRegion> uniform = source_->uniformOver(box);
    if (!uniform || !isFloating(info_.type)) return uniform;
    if (policy_ != NonFinite::kReject)
        for (ValueBits& bits : uniform->value) bits = finiteBits(info_.type, bits, policy_);
    return uniform;
}

Result<void> FiniteField::read(const IndexBox& box, SampleBlock& out) const {
    if (Result<void> read = source_->read(box, out); !read) return read;
    if (!isFloating(info_.type)) return {};
    const bool single = info_.type == SampleType::kFloat32;
    const std::size_t at = single ? scan<float>(out.values, policy_) : scan<double>(out.values, policy_);
    if (at == out.values.size() / sampleBytes(info_.type)) return {};

    const std::size_t voxel = at % std::size_t(box.extent(0) * box.extent(1) * box.extent(2));
    const std::int64_t x = box.begin[0] + std::int64_t(voxel) % box.extent(0);
    const std::int64_t y = box.begin[1] + std::int64_t(voxel) / box.extent(0) % box.extent(1);
    const std::int64_t z = box.begin[2] + std::int64_t(voxel) / box.extent(0) / box.extent(1);
    return refuseNonFinite(info_, {x, y, z});
}

tl::unexpected<Error> refuseNonFinite(const ChannelInfo& channel, const Index3& voxel) {
    return fail(ErrorCode::kInvalid,
                fmt::format("channel '{}': voxel ({}, {}, {}) is not finite; convert with --nonfinite "
                            "zero or clamp to replace such values",
                            channel.name, voxel[0], voxel[1], voxel[2]));
}

}  // namespace brickyard
