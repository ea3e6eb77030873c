#include "tools/importers/nrrd_header.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <limits>
#include <map>

#include "core/printable_name.h"

namespace brickyard {
namespace {

constexpr std::size_t kMaxDimension = 16;  // NRRD's own limit

std::string_view trimmed(std::string_view text) {
    const std::size_t begin = text.find_first_not_of(" \t");
    if (begin == std::string_view::npos) return {};
    return text.substr(begin, text.find_last_not_of(" \t") + 1 - begin);
}

std::string lowered(std::string_view text) {
    std::string lower(text);
    for (char& c : lower)
        if (c >= 'A' && c <= 'Z') c = char(c - 'A' + 'a');
    return lower;
}

std::string_view takeLine(std::string_view& text) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    if (line.ends_with('\r')) line.remove_suffix(1);
    return line;
}

template <class Number>
bool parseNumber(std::string_view text, Number& value) {
    if (text.starts_with('+')) text.remove_prefix(1);
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value);
    return !text.empty() && parsed.ec == std::errc() && parsed.ptr == text.data() + text.size();
}

std::vector<std::string_view> words(std::string_view text) {
    std::vector<std::string_view> result;
    while (!(text = trimmed(text)).empty()) {
        const std::size_t end = std::min(text.find_first_of(" \t"), text.size());
        result.push_back(text.substr(0, end));
        text.remove_prefix(end);
    }
    return result;
}

tl::unexpected<Error> invalid(std::string_view field, std::string_view value, const std::string& why) {
    return fail(ErrorCode::kInvalid,
                fmt::format("header field '{}: {}' {}", field, printableName(std::string(value)), why));
}
tl::unexpected<Error> unsupported(const std::string& why) { return fail(ErrorCode::kUnsupported, why); }

std::optional<ElementType> parseType(const std::string& name) {
    static const std::map<std::string, ElementType> kNames{{"signed char", ElementType::kInt8},
                                                           {"int8", ElementType::kInt8},
                                                           {"int8_t", ElementType::kInt8},
                                                           {"uchar", ElementType::kUint8},
                                                           {"unsigned char", ElementType::kUint8},
                                                           {"uint8", ElementType::kUint8},
                                                           {"uint8_t", ElementType::kUint8},
                                                           {"short", ElementType::kInt16},
                                                           {"short int", ElementType::kInt16},
                                                           {"signed short", ElementType::kInt16},
                                                           {"signed short int", ElementType::kInt16},
                                                           {"int16", ElementType::kInt16},
                                                           {"int16_t", ElementType::kInt16},
                                                           {"ushort", ElementType::kUint16},
                                                           {"unsigned short", ElementType::kUint16},
                                                           {"unsigned short int", ElementType::kUint16},
                                                           {"uint16", ElementType::kUint16},
                                                           {"uint16_t", ElementType::kUint16},
                                                           {"int", ElementType::kInt32},
                                                           {"signed int", ElementType::kInt32},
                                                           {"int32", ElementType::kInt32},
                                                           {"int32_t", ElementType::kInt32},
                                                           {"uint", ElementType::kUint32},
                                                           {"unsigned int", ElementType::kUint32},
                                                           {"uint32", ElementType::kUint32},
                                                           {"uint32_t", ElementType::kUint32},
                                                           {"longlong", ElementType::kInt64},
                                                           {"long long", ElementType::kInt64},
                                                           {"long long int", ElementType::kInt64},
                                                           {"signed long long", ElementType::kInt64},
                                                           {"signed long long int", ElementType::kInt64},
                                                           {"int64", ElementType::kInt64},
                                                           {"int64_t", ElementType::kInt64},
                                                           {"ulonglong", ElementType::kUint64},
                                                           {"unsigned long long", ElementType::kUint64},
                                                           {"unsigned long long int", ElementType::kUint64},
                                                           {"uint64", ElementType::kUint64},
                                                           {"uint64_t", ElementType::kUint64},
                                                           {"float", ElementType::kFloat32},
                                                           {"double", ElementType::kFloat64},
                                                           // Not NRRD's, but written by some.
                                                           {"float32", ElementType::kFloat32},
                                                           {"float64", ElementType::kFloat64},
                                                           {"float16", ElementType::kFloat16},
                                                           {"half", ElementType::kFloat16}};
    const auto found = kNames.find(name);
    return found == kNames.end() ? std::nullopt : std::optional(found->second);
}

using Direction = std::optional<std::array<double, 3>>;  // nothing: "none"

// "(1,0,0) none (0,1,0)". False where it is not such a list, or a vector has not three components.
bool parseVectors(std::string_view text, std::vector<Direction>& vectors) {
    while (!(text = trimmed(text)).empty() && vectors.size() <= kMaxDimension) {
        if (text.starts_with("none")) {
            vectors.push_back(std::nullopt);
            text.remove_prefix(4);
            continue;
        }
        const std::size_t close = text.find(')');
        if (text[0] != '(' || close == std::string_view::npos) return false;
        std::string_view inside = text.substr(1, close - 1);
        text.remove_prefix(close + 1);
        std::array<double, 3> vector;
        for (std::size_t i = 0; i < 3; ++i) {
            const std::size_t comma = inside.find(',');
            if ((comma == std::string_view::npos) != (i == 2)) return false;
            if (!parseNumber(trimmed(inside.substr(0, comma)), vector[i])) return false;
            if (i < 2) inside.remove_prefix(comma + 1);
        }
        vectors.push_back(vector);
    }
    return true;
}

// OpenVDB's word for the vectors along an axis of this kind; empty: the kind is none of vectors.
std::string vectorTypeOf(const std::string& kind) {
    if (kind == "vector" || kind == "3-vector" || kind == "3-color" || kind == "rgb-color" ||
        kind == "xyz-color" || kind == "hsv-color" || kind == "contravariant-vector")
        return "invariant";
    if (kind == "covariant-vector" || kind == "3-gradient") return "covariant";
    if (kind == "normal" || kind == "3-normal") return "covariant normalize";
    return "";
}

// The fields by name, and what can be made of them.
class HeaderParser {
public:
    Result<NrrdHeader> parse(std::string_view text) {
        if (auto read = readFields(text); !read) return tl::unexpected(read.error());
        if (auto shape = readShape(); !shape) return tl::unexpected(shape.error());
        if (auto storage = readStorage(); !storage) return tl::unexpected(storage.error());
        if (auto transform = readTransform(); !transform) return tl::unexpected(transform.error());
        for (const char* note : {"content", "space", "sample units"})
            if (const std::string* value = find(note)) addMetadata(note, *value);
        return std::move(header_);
    }

private:
    Result<void> readFields(std::string_view text) {
        const std::string_view magic = takeLine(text);
        if (!magic.starts_with("NRRD000") || magic.size() != 8 || magic[7] < '1' || magic[7] > '9')
            return invalid("magic", magic.substr(0, 8), "is not NRRD0001 to NRRD0005");
        if (magic[7] > '5')
            return fail(ErrorCode::kTooNew,
                        fmt::format("{} is newer than NRRD0005; save it in an older one", magic));
        while (!text.empty()) {
            const std::string_view line = takeLine(text);
            if (line.empty()) break;
            if (line[0] == '#') continue;
            const std::size_t colon = line.find(':');
            if (colon == std::string_view::npos || colon + 1 == line.size())
                return invalid(printableName(std::string(line.substr(0, colon))), "",
                               "has no value; write the file again");
            if (line[colon + 1] == '=') {
                addMetadata(std::string(line.substr(0, colon)), unescaped(line.substr(colon + 2)));
                continue;
            }
            std::string name = lowered(line.substr(0, colon));
            // Two spellings of one field.
            for (const auto& [other, real] : {std::pair("datafile", "data file"),
                                              {"byteskip", "byte skip"},
                                              {"lineskip", "line skip"},
                                              {"axismins", "axis mins"},
                                              {"axismaxs", "axis maxs"},
                                              {"centerings", "centers"},
                                              {"sampleunits", "sample units"}})
                if (name == other) name = real;
            if (!fields_.emplace(name, trimmed(line.substr(colon + 1))).second)
                return invalid(printableName(name), line.substr(colon + 1),
                               "stands there twice; write the file again");
        }
        return {};
    }

    static std::string unescaped(std::string_view text) {
        std::string result;
        for (std::size_t i = 0; i < text.size(); ++i) {
            const bool escape =
                text[i] == '\\' && i + 1 < text.size() && (text[i + 1] == 'n' || text[i + 1] == '\\');
            if (escape) ++i;
            result += escape && text[i] == 'n' ? '\n' : text[i];
        }
        return result;
    }

    void addMetadata(const std::string& name, const std::string& value) {
        const std::string key = validUtf8(name);
        if (key.empty() ||
            std::ranges::any_of(header_.metadata, [&](const auto& entry) { return entry.name == key; }))
            return;
        header_.metadata.push_back({key, "string", value});
    }

    const std::string* find(const std::string& field) const {
        const auto found = fields_.find(field);
        return found == fields_.end() ? nullptr : &found->second;
    }
    Result<std::string> require(const std::string& field) const {
        if (const std::string* value = find(field)) return *value;
        return fail(ErrorCode::kInvalid,
                    fmt::format("its header has no field '{}'; write the file again", field));
    }
    // One word per axis; empty where the field is absent.
    Result<std::vector<std::string>> perAxis(const std::string& field) const {
        std::vector<std::string> result;
        const std::string* value = find(field);
        if (!value) return result;
        for (const std::string_view word : words(*value)) result.push_back(lowered(word));
        if (result.size() != sizes_.size())
            return invalid(field, *value,
                           fmt::format("has not one entry for each of the {} axes", sizes_.size()));
        return result;
    }

    // Sizes, components and the type: which axes are x, y and z.
    Result<void> readShape() {
        const auto dimension = require("dimension");
        if (!dimension) return tl::unexpected(dimension.error());
        std::size_t count = 0;
        if (!parseNumber(*dimension, count) || count < 1 || count > kMaxDimension)
            return invalid("dimension", *dimension, "is not between 1 and 16");
        const auto sizes = require("sizes");
        if (!sizes) return tl::unexpected(sizes.error());
        for (const std::string_view word : words(*sizes)) {
            std::int64_t size = 0;
            if (!parseNumber(word, size) || size < 1 || size > std::numeric_limits<std::int32_t>::max())
                return invalid("sizes", *sizes, "is not a list of numbers from 1 to 2147483647");
            sizes_.push_back(size);
            if (sizes_.size() > count) break;
        }
        if (sizes_.size() != count)
            return invalid("sizes", *sizes, fmt::format("has not one entry for each of the {} axes", count));
        const auto kinds = perAxis("kinds");
        if (!kinds) return tl::unexpected(kinds.error());
        if (const std::string* text = find("space directions")) {
            if (!parseVectors(*text, directions_))
                return invalid("space directions", *text,
                               "is not a list of vectors of three numbers and `none`; only spaces of three "
                               "dimensions convert");
            if (directions_.size() != count)
                return invalid("space directions", *text,
                               fmt::format("has not one entry for each of the {} axes", count));
        }
        if (auto axes = findAxes(*kinds); !axes) return axes;
        for (std::size_t i = 0; i < 3; ++i) header_.layout.extents[i] = sizes_[axes_[i]];

        const auto type = require("type");
        if (!type) return tl::unexpected(type.error());
        const auto element = parseType(lowered(*type));
        if (!element)
            return unsupported(
                fmt::format("its type '{}' does not convert; there are the integers of 8 to 64 bits, float "
                            "and double",
                            printableName(*type)));
        header_.layout.element = *element;
        if (const auto bytes = header_.layout.bytes(); !bytes)
            return invalid("sizes", *sizes, "is impossible: " + bytes.error().message);
        return {};
    }

    // Three axes of space, and at most one of three components in front of or behind them. Axes of one sample
    // count for nothing where there are more than three.
    Result<void> findAxes(const std::vector<std::string>& kinds) {
        const std::size_t count = sizes_.size();
        const auto kindOf = [&](std::size_t axis) {
            return kinds.empty() ? std::string("???") : kinds[axis];
        };
        const auto nowhere = [&](std::size_t axis) { return !directions_.empty() && !directions_[axis]; };
        std::optional<std::size_t> vector;
        for (std::size_t axis = 0; axis < count; ++axis) {
            const std::string type = vectorTypeOf(kindOf(axis));
            // Without kinds, an axis that leads nowhere in space.
            const bool unnamed =
                (kindOf(axis) == "???" || kindOf(axis) == "none" || kindOf(axis) == "list") && nowhere(axis);
            if (count > 3 && sizes_[axis] == 1 && (axes_.size() + (count - axis) > 3) &&
                (nowhere(axis) || directions_.empty()))
                continue;
            if (!type.empty() || (unnamed && sizes_[axis] == 3)) {
                if (vector)
                    return unsupported(
                        "has two axes of vector components; only volumes of scalars and of vectors of 3 "
                        "convert");
                if (sizes_[axis] != 3)
                    return unsupported(fmt::format(
                        "has vectors of {} components; only scalars and vectors of 3 convert", sizes_[axis]));
                vector = axis;
                header_.layout.components = 3;
                header_.vector_type = type.empty() ? "invariant" : type;
                continue;
            }
            if (nowhere(axis) || (kindOf(axis) != "???" && kindOf(axis) != "none" &&
                                  kindOf(axis) != "domain" && kindOf(axis) != "space"))
                return unsupported(
                    fmt::format("its axis {} of {} samples has kind '{}', which is no axis of space; only "
                                "volumes of scalars and of vectors of 3 convert",
                                axis, sizes_[axis], printableName(kindOf(axis))));
            axes_.push_back(axis);
        }
        if (axes_.size() != 3)
            return unsupported(fmt::format("has {} axes of space{}; only volumes, which have 3, convert",
                                           axes_.size(),
                                           count > 3 && !vector ? " and none of kind 'vector'" : ""));
        if (vector && *vector > axes_[0] && *vector < axes_[2])
            return unsupported(fmt::format(
                "has its vector components on axis {}; they convert on the first or the last", *vector));
        header_.layout.interleaved = !vector || *vector < axes_[0];
        return {};
    }

    Result<void> readStorage() {
        const auto encoding = require("encoding");
        if (!encoding) return tl::unexpected(encoding.error());
        const std::string name = lowered(*encoding);
        if (name == "raw")
            header_.encoding = NrrdEncoding::kRaw;
        else if (name == "gz" || name == "gzip")
            header_.encoding = NrrdEncoding::kGzip;
        else if (name == "txt" || name == "text" || name == "ascii")
            header_.encoding = NrrdEncoding::kText;
        else
            return unsupported(
                fmt::format("its encoding '{}' does not convert; save it as raw, gzip or ascii",
                            printableName(*encoding)));

        const std::string* endian = find("endian");
        if (endian && lowered(*endian) != "little" && lowered(*endian) != "big")
            return invalid("endian", *endian, "is neither little nor big");
        const bool needed =
            elementBytes(header_.layout.element) > 1 && header_.encoding != NrrdEncoding::kText;
        if (needed && !endian)
            return fail(ErrorCode::kInvalid,
                        "its header has no field 'endian', which its type needs; add endian: little or big");
        header_.layout.big_endian = needed && lowered(*endian) == "big";

        if (const std::string* skip = find("line skip"); skip && !parseNumber(*skip, header_.line_skip))
            return invalid("line skip", *skip, "is no number from 0 up");
        if (const std::string* skip = find("byte skip"))
            if (!parseNumber(*skip, header_.byte_skip) || header_.byte_skip < -1 ||
                (header_.byte_skip == -1 && header_.encoding != NrrdEncoding::kRaw))
                return invalid("byte skip", *skip, "is no number from 0 up (or -1 for raw data)");
        if (const std::string* file = find("data file")) {
            if (file->starts_with("LIST") || file->find('%') != std::string::npos)
                return unsupported("its data are in several files; join them to one");
            header_.data_file = *file;
        }
        return {};
    }

    Result<std::array<std::optional<double>, 3>> numbersOf(const std::string& field) const {
        std::array<std::optional<double>, 3> result;
        const auto all = perAxis(field);
        if (!all) return tl::unexpected(all.error());
        if (all->empty()) return result;
        for (std::size_t i = 0; i < 3; ++i) {
            double value = 0;
            const std::string& word = (*all)[axes_[i]];
            if (!parseNumber(word, value)) return invalid(field, *find(field), "is not a list of numbers");
            // NaN is how NRRD says "unknown".
            if (!std::isnan(value)) result[i] = value;
        }
        return result;
    }

    Result<void> readTransform() {
        std::array<double, 16> columns{};
        columns[15] = 1;
        if (const std::string* dimension = find("space dimension"); dimension && *dimension != "3")
            return unsupported(
                fmt::format("its space has {} dimensions; only 3 convert", printableName(*dimension)));
        if (const std::string* space = find("space"); space && lowered(*space).ends_with("time"))
            return unsupported(
                fmt::format("its space '{}' has four dimensions; only 3 convert", printableName(*space)));
        if (!directions_.empty()) {
            for (std::size_t i = 0; i < 3; ++i)
                std::ranges::copy(*directions_[axes_[i]], columns.begin() + std::ptrdiff_t(4 * i));
            // Whatever the centering says: the space origin is the centre of the first sample.
            if (const std::string* text = find("space origin")) {
                std::vector<Direction> origin;
                if (!parseVectors(*text, origin) || origin.size() != 1 || !origin[0])
                    return invalid("space origin", *text, "is not one vector of three numbers");
                std::ranges::copy(*origin[0], columns.begin() + 12);
            }
        } else if (auto spaced = readSpacings(columns); !spaced) {
            return spaced;
        }
        auto transform = Affine::fromColumns(columns);
        if (!transform)
            return fail(ErrorCode::kInvalid,
                        fmt::format("its axes make no usable transform ({}); correct its space directions, "
                                    "space origin or spacings",
                                    transform.error().message));
        header_.index_to_world = *transform;
        return {};
    }

    // Axes along those of the world. A cell's first sample is half a spacing behind the axis' minimum, a
    // node's on it.
    Result<void> readSpacings(std::array<double, 16>& columns) const {
        const auto spacings = numbersOf("spacings");
        if (!spacings) return tl::unexpected(spacings.error());
        const auto least = numbersOf("axis mins"), largest = numbersOf("axis maxs");
        if (!least) return tl::unexpected(least.error());
        if (!largest) return tl::unexpected(largest.error());
        const auto centers = perAxis("centers");
        if (!centers) return tl::unexpected(centers.error());
        for (std::size_t i = 0; i < 3; ++i) {
            const bool node = !centers->empty() && (*centers)[axes_[i]] == "node";
            const auto samples = double(sizes_[axes_[i]]);
            double spacing = 1;
            if ((*spacings)[i])
                spacing = *(*spacings)[i];
            else if ((*least)[i] && (*largest)[i] && (!node || samples > 1))
                spacing = (*(*largest)[i] - *(*least)[i]) / (node ? samples - 1 : samples);
            columns[5 * i] = spacing;
            if ((*least)[i]) columns[12 + i] = *(*least)[i] + (node ? 0 : 0.5 * spacing);
        }
        return {};
    }

    std::map<std::string, std::string> fields_;
    std::vector<std::int64_t> sizes_;
    std::vector<Direction> directions_;  // empty, or one per axis
    std::vector<std::size_t> axes_;      // which are x, y and z
    NrrdHeader header_;
};

}  // namespace

std::optional<std::size_t> findNrrdData(std::string_view text) {
    const std::size_t unix_end = text.find("\n\n"), dos_end = text.find("\r\n\r\n");
    if (unix_end == std::string_view::npos && dos_end == std::string_view::npos) return std::nullopt;
    return dos_end < unix_end ? dos_end + 4 : unix_end + 2;
}

Result<NrrdHeader> parseNrrdHeader(std::string_view text) { return HeaderParser().parse(text); }

}  // namespace brickyard
