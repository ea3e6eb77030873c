// The input as a payload and as a draft: both decoders of each must survive it and agree. The input as
// samples and states: what was encoded must come back, within the error that was allowed and with the error
// that was reported; so must its draft.
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "core/brick_codec.h"

using namespace brickyard;

namespace {

void require(bool holds) {
    if (!holds) std::abort();
}

ValueBits bitsAt(const std::vector<std::byte>& values, SampleType type, std::size_t i) {
    ValueBits bits = 0;
    std::memcpy(&bits, &values[i * sampleBytes(type)], sampleBytes(type));
    return bits;
}

std::vector<float> floatsOf(std::span<const std::byte> payload, BrickShape shape, SampleType type,
                            int components, bool& decoded) {
    std::vector<float> floats(shape.samples() * std::size_t(components));
    decoded = bool(decodeBrickToFloat(payload, shape, type, components, floats));
    return floats;
}

void readAsPayload(std::span<const std::byte> payload, BrickShape shape, SampleType type, int components) {
    const ValueBits background[3] = {0, 1, 2};
    bool decoded = false;
    const auto floats = floatsOf(payload, shape, type, components, decoded);
    const auto brick = decodeBrick(payload, shape, type, components, background);
    if (!brick) return;
    require(decoded);
    require(brick->active.empty() || brick->active.size() == shape.cells());
    for (std::size_t i = 0; i < floats.size(); ++i) {
        require(std::isfinite(floats[i]));
        require(floats[i] == toFloat(type, bitsAt(brick->values, type, i)));
    }
}

void readAsDraft(std::span<const std::byte> payload, BrickShape shape, SampleType type, int components) {
    std::vector<float> floats(shape.samples() * std::size_t(components));
    const bool decoded = bool(decodeDraftToFloat(payload, shape, type, components, floats));
    const auto brick = decodeDraft(payload, shape, type, components);
    require(decoded == bool(brick));
    if (!brick) return;
    require(isFloating(type) && brick->active.empty());
    for (std::size_t i = 0; i < floats.size(); ++i) {
        require(std::isfinite(floats[i]));
        require(floats[i] == toFloat(type, bitsAt(brick->values, type, i)));
    }
}

double deviation(const std::vector<std::byte>& a, const std::vector<std::byte>& b, SampleType type) {
    double largest = 0;
    for (std::size_t i = 0; i < a.size() / sampleBytes(type); ++i)
        largest = std::max(largest,
                           std::abs(toDouble(type, bitsAt(a, type, i)) - toDouble(type, bitsAt(b, type, i))));
    return largest;
}

void roundTrip(std::span<const std::byte> input, BrickShape shape, SampleType type, int components,
               double max_error) {
    std::vector<std::byte> values(shape.samples() * std::size_t(components) * sampleBytes(type));
    bool finite = true;
    for (std::size_t i = 0; i < values.size(); ++i) {
        // The input again and again, changed a little each time: repetition alone would be too easy to
        // compress.
        values[i] = input.empty() ? std::byte{0}
                                  : input[i % input.size()] ^ std::byte(std::uint8_t(i / input.size() % 7));
        if (type == SampleType::kBool) values[i] &= std::byte{1};
    }
    for (std::size_t i = 0; i < values.size() / sampleBytes(type); ++i)
        finite = finite && std::isfinite(toDouble(type, bitsAt(values, type, i)));
    std::vector<std::uint8_t> active(shape.cells());
    for (std::size_t i = 0; i < active.size(); ++i)
        active[i] = std::uint8_t(values[i * 5 % values.size()]) & 1;
    const ValueBits background[3] = {bitsAt(values, type, 0), 0, 0};

    const EncodedBrick encoded =
        encodeBrick({shape, type, components, values, active, background, max_error});
    require(encoded.error_made <= max_error);
    const auto brick = decodeBrick(encoded.payload, shape, type, components, background);
    require(bool(brick));

    // The same brick exactly, with what was its error now its draft's.
    const EncodedBrick drafted =
        encodeBrick({shape, type, components, values, active, background, /*max_error=*/0, max_error});
    const auto exact = decodeBrick(drafted.payload, shape, type, components, background);
    require(exact && exact->values == values && exact->active == active);
    if (drafted.draft_bytes > 0) {
        require(finite && drafted.draft_bytes < drafted.payload.size() &&
                drafted.draft_error_made <= max_error);
        const auto draft =
            decodeDraft(std::span(drafted.payload).first(drafted.draft_bytes), shape, type, components);
        require(draft && deviation(values, draft->values, type) == drafted.draft_error_made);
    }

    require(brick->active == active);
    if (encoded.error_made == 0 && (!finite || !isFloating(type) || max_error == 0)) {
        require(brick->values == values);
        return;
    }
    require(deviation(values, brick->values, type) == encoded.error_made);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size < 3) return 0;
    const auto type = SampleType(1 + data[0] % 5);
    const int components = 1 + data[0] / 5 % 3;
    const BrickShape shape{data[1] % 4 == 0 ? 16 : 8};
    const double max_error = data[2] == 0 ? 0 : std::pow(2.0, (int(data[2]) - 128) / 2.0);
    const auto input = std::as_bytes(std::span(data, size)).subspan(3);
    readAsPayload(input, shape, type, components);
    readAsDraft(input, shape, type, components);
    roundTrip(input, shape, type, components, max_error);
    return 0;
}
