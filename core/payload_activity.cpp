#include "core/payload_activity.h"

#include <cstring>

namespace brickyard {
namespace {

template <class W>
void mark(const std::byte* values, BrickShape shape, W background, std::uint8_t* states) {
    const auto edge = std::size_t(shape.edge_cells);
    for (int z = 0; z < shape.edge_cells; ++z)
        for (int y = 0; y < shape.edge_cells; ++y) {
            const std::byte* const row = values + shape.sampleAt(0, y, z) * sizeof(W);
            std::uint8_t* const out = states + shape.cellAt(0, y, z);
            for (std::size_t x = 0; x < edge; ++x) {
                W bits;
                std::memcpy(&bits, row + x * sizeof(W), sizeof(W));
                out[x] = std::uint8_t(out[x] | std::uint8_t(bits != background));
            }
        }
}

}  // namespace

std::vector<std::uint8_t> statesByBackground(std::span<const std::byte> values, BrickShape shape,
                                             SampleType type, int components,
                                             std::span<const ValueBits> background) {
    std::vector<std::uint8_t> states(shape.cells(), 0);
    for (std::size_t c = 0; c < std::size_t(components); ++c) {
        const std::byte* const samples = values.data() + c * shape.samples() * sampleBytes(type);
        switch (sampleBytes(type)) {
            case 1: mark(samples, shape, std::uint8_t(background[c]), states.data()); break;
            case 4: mark(samples, shape, std::uint32_t(background[c]), states.data()); break;
            default: mark(samples, shape, std::uint64_t(background[c]), states.data()); break;
        }
    }
    return states;
}

}  // namespace brickyard
