#include "core/percent_code.h"

#include <charconv>

namespace brickyard {

std::string percentEncode(std::string_view text) {
    constexpr std::string_view kPlain = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789-._~";
    constexpr std::string_view kHex = "0123456789ABCDEF";
    std::string encoded;
    for (const char c : text) {
        if (kPlain.find(c) != std::string_view::npos) {
            encoded += c;
        } else {
            const auto byte = static_cast<unsigned char>(c);
            encoded += '%';
            encoded += kHex[byte >> 4];
            encoded += kHex[byte & 15];
        }
    }
    return encoded;
}

Result<std::string> percentDecode(std::string_view text) {
    std::string decoded;
    for (std::size_t i = 0; i < text.size(); ++i) {
        if (text[i] != '%') {
            decoded += text[i];
            continue;
        }
        unsigned value = 0;
        const char* digits = text.data() + i + 1;
        if (text.size() - i < 3 || std::from_chars(digits, digits + 2, value, 16).ptr != digits + 2)
            return fail(ErrorCode::kInvalid, "a '%' is not followed by two hex digits; write it as %25");
        // No name of ours has a zero byte, and paths would end there.
        if (value == 0) return fail(ErrorCode::kInvalid, "a name holds a zero byte (%00); remove it");
        decoded += char(value);
        i += 2;
    }
    return decoded;
}

}  // namespace brickyard
