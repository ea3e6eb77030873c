// Dense volumes as bytes, read by a formula of their layout and by nothing of ours.
#pragma once

#include <gtest/gtest.h>
#include <zlib.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <random>
#include <string>

#include "core/field_source.h"

namespace brickyard {

// What a raw dump's bytes say, told by a person's reading of the layout and nothing else.
struct RawFile {
    std::int64_t nx, ny, nz;
    std::string type;
    bool z_fastest = false, big = false;
    std::string bytes;

    std::size_t width() const {
        if (type.ends_with("64")) return 8;
        if (type.ends_with("32")) return 4;
        return type.ends_with("16") ? 2 : 1;
    }
    std::uint64_t bits(std::int64_t x, std::int64_t y, std::int64_t z) const {
        const std::int64_t i = z_fastest ? (x * ny + y) * nz + z : (z * ny + y) * nx + x;
        std::uint64_t value = 0;
        for (std::size_t b = 0; b < width(); ++b) {
            const auto byte = std::uint64_t(std::uint8_t(bytes[std::size_t(i) * width() + b]));
            value |= byte << 8 * (big ? width() - 1 - b : b);
        }
        return value;
    }
    // As this project stores it.
    ValueBits expected(std::int64_t x, std::int64_t y, std::int64_t z) const {
        const std::uint64_t v = bits(x, y, z);
        if (type == "int8") return std::uint32_t(std::int32_t(std::int8_t(v)));
        if (type == "int16") return std::uint32_t(std::int32_t(std::int16_t(v)));
        if (type == "float16") {
            const int exponent = int(v >> 10 & 31), mantissa = int(v & 1023);
            const double value =
                exponent == 0 ? std::ldexp(mantissa, -24) : std::ldexp(1024 + mantissa, exponent - 25);
            return std::bit_cast<std::uint32_t>(float(v >> 15 ? -value : value));
        }
        return v;
    }
    std::string layout() const {
        return std::to_string(nx) + "x" + std::to_string(ny) + "x" + std::to_string(nz) + ":" + type +
               (z_fastest ? ":z-fastest" : "") + (big ? ":big" : "");
    }
};

// Any bits that are finite numbers and, as uint64, not too large.
inline RawFile randomRaw(std::int64_t nx, std::int64_t ny, std::int64_t nz, const std::string& type,
                         bool z_fastest, bool big, unsigned seed) {
    RawFile raw{nx, ny, nz, type, z_fastest, big, ""};
    raw.bytes.resize(std::size_t(nx * ny * nz) * raw.width());
    std::mt19937 random(seed);
    for (char& byte : raw.bytes) byte = char(random());
    // The exponent's or the number's highest bit is off.
    const unsigned char mask = type == "uint64" ? 0x7f : 0xbf;
    if (type.starts_with("float") || type == "uint64")
        for (std::size_t i = 0; i < raw.bytes.size(); i += raw.width()) {
            char& high = raw.bytes[big ? i : i + raw.width() - 1];
            high = char(std::uint8_t(high) & mask);
        }
    return raw;
}

inline void expectValues(const FieldSource& field, const RawFile& raw, const IndexBox& box) {
    SampleBlock block;
    const auto read = field.read(box, block);
    ASSERT_TRUE(read) << read.error().message;
    const std::size_t bytes = sampleBytes(field.info().type);
    std::size_t i = 0, wrong = 0;
    for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
        for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y)
            for (std::int64_t x = box.begin[0]; x < box.end[0]; ++x, ++i) {
                const bool inside = x >= 0 && y >= 0 && z >= 0 && x < raw.nx && y < raw.ny && z < raw.nz;
                ValueBits value = 0;
                std::memcpy(&value, block.values.data() + i * bytes, bytes);
                wrong += block.active[i] != inside || value != (inside ? raw.expected(x, y, z) : 0);
            }
    EXPECT_EQ(wrong, 0u) << raw.layout() << ", box at " << box.begin[0] << " " << box.begin[1] << " "
                         << box.begin[2];
}

inline std::string gzipped(const std::string& bytes) {
    z_stream stream{};
    ::deflateInit2(&stream, 6, Z_DEFLATED, 15 + 16, 8, Z_DEFAULT_STRATEGY);
    std::string packed(::deflateBound(&stream, bytes.size()), '\0');
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
    stream.avail_in = uInt(bytes.size());
    stream.next_out = reinterpret_cast<Bytef*>(packed.data());
    stream.avail_out = uInt(packed.size());
    ::deflate(&stream, Z_FINISH);
    packed.resize(stream.total_out);
    ::deflateEnd(&stream);
    return packed;
}

}  // namespace brickyard
