#include "tools/importers/raw_layout.h"

#include <fmt/format.h>

#include <charconv>

#include "core/printable_name.h"

namespace brickyard {
namespace {

constexpr const char* kExample =
    "write it as 128x128x128:uint16, with :z-fastest, :big or :skip=BYTES as needed";

template <class Number>
bool parseNumber(std::string_view text, Number& value) {
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
    return parsed.ec == std::errc() && parsed.ptr == text.data() + text.size() && !text.empty();
}

// The part of `text` up to `separator`, which is taken off.
std::string_view takePart(std::string_view& text, char separator) {
    const std::size_t end = std::min(text.find(separator), text.size());
    const std::string_view part = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    return part;
}

tl::unexpected<Error> invalid(std::string_view part, const std::string& what) {
    return fail(ErrorCode::kInvalid,
                fmt::format("'{}' in the layout of a raw dump {}", printableName(std::string(part)), what));
}

}  // namespace

Result<RawLayout> parseRawLayout(std::string_view text) {
    RawLayout layout;
    DenseLayout& dense = layout.dense;
    const std::string_view extents = takePart(text, ':');
    std::string_view left = extents;
    for (int axis = 0; axis < 3; ++axis)
        if (!parseNumber(takePart(left, axis < 2 ? 'x' : '\0'), dense.extents[std::size_t(axis)]))
            return invalid(extents, fmt::format("is not XxYxZ voxels; {}", kExample));
    const std::string_view type = takePart(text, ':');
    const auto element = elementTypeFromName(type);
    if (!element)
        return invalid(
            type,
            "is no type; there are uint8, int8, uint16, int16, uint32, int32, uint64, int64, float16, "
            "float32 and float64");
    dense.element = *element;
    while (!text.empty()) {
        const std::string_view part = takePart(text, ':');
        std::string_view value = part;
        const std::string_view key = takePart(value, '=');
        if (part == "x-fastest") {
            dense.z_fastest = false;
        } else if (part == "z-fastest") {
            dense.z_fastest = true;
        } else if (part == "little") {
            dense.big_endian = false;
        } else if (part == "big") {
            dense.big_endian = true;
        } else if (key == "skip" || key == "header" || key == "trailing") {
            std::uint64_t& bytes = key == "trailing" ? layout.trailing_bytes : dense.offset;
            if (!parseNumber(value, bytes) || bytes > std::uint64_t(1) << 62)
                return invalid(part, fmt::format("is no number of bytes; {}", kExample));
        } else {
            return invalid(part,
                           "is unknown; there are x-fastest, z-fastest, little, big, skip=BYTES, "
                           "header=BYTES and trailing=BYTES");
        }
    }
    if (const auto bytes = dense.bytes(); !bytes)
        return invalid(extents, "is impossible: " + bytes.error().message);
    return layout;
}

}  // namespace brickyard
