// What NanoVDB's types of value are here, and memory for its nodes. Only nano_source.cpp includes this.
#pragma once

#include <nanovdb/NanoVDB.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <type_traits>
#include <vector>

#include "core/sample_type.h"

namespace brickyard {

inline constexpr std::size_t kAlignment = 32;  // of every node in a grid
inline constexpr std::int64_t kInt32Min = std::numeric_limits<std::int32_t>::min();
inline constexpr std::int64_t kInt32End = std::int64_t(std::numeric_limits<std::int32_t>::max()) + 1;

// What a grid's value is here. `Stored` is what stands in tiles.
template <class Build>
struct NanoValue {
    using Stored = typename nanovdb::BuildToValueMap<Build>::Type;
    using Component = Stored;
    static constexpr int kComponents = 1;
};
template <>
struct NanoValue<std::int16_t> {
    using Stored = std::int16_t;
    using Component = std::int32_t;
    static constexpr int kComponents = 1;
};
template <>
struct NanoValue<std::uint32_t> {
    using Stored = std::uint32_t;
    using Component = std::int64_t;
    static constexpr int kComponents = 1;
};
template <class T>
struct NanoValue<nanovdb::Vec3<T>> {
    using Stored = nanovdb::Vec3<T>;
    using Component = T;
    static constexpr int kComponents = 3;
};

template <class T>
constexpr SampleType sampleTypeFor() {
    if constexpr (std::is_same_v<T, float>) return SampleType::kFloat32;
    if constexpr (std::is_same_v<T, double>) return SampleType::kFloat64;
    if constexpr (std::is_same_v<T, std::int32_t>) return SampleType::kInt32;
    if constexpr (std::is_same_v<T, std::int64_t>) return SampleType::kInt64;
    if constexpr (std::is_same_v<T, bool>) return SampleType::kBool;
}

// Memory aligned as NanoVDB's structs want it, grown as needed.
class NodeBuffer {
public:
    std::span<std::byte> of(std::size_t bytes) {
        blocks_.resize(bytes / kAlignment + 1);
        return {reinterpret_cast<std::byte*>(blocks_.data()), bytes};
    }

private:
    struct alignas(kAlignment) Block {
        std::byte bytes[kAlignment];
    };
    std::vector<Block> blocks_;
};

}  // namespace brickyard
