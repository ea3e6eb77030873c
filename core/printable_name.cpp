#include "core/printable_name.h"

#include <fmt/format.h>

namespace brickyard {

std::string validUtf8(const std::string& name) {
    std::string result;
    for (std::size_t i = 0; i < name.size();) {
        const auto byte = [&](std::size_t k) {
            return i + k < name.size() ? static_cast<unsigned char>(name[i + k]) : 0u;
        };
        const unsigned lead = byte(0);
        const std::size_t length = lead < 0x80       ? 1
                                   : lead >> 5 == 6  ? 2
                                   : lead >> 4 == 14 ? 3
                                   : lead >> 3 == 30 ? 4
                                                     : 0;
        bool valid = length > 0;
        for (std::size_t k = 1; k < length; ++k) valid = valid && byte(k) >> 6 == 2;
        // Overlong forms, surrogates and numbers past U+10FFFF look right by their lead byte alone.
        if (length == 2) valid = valid && lead >= 0xc2;
        if (length == 3)
            valid = valid && !(lead == 0xe0 && byte(1) < 0xa0) && !(lead == 0xed && byte(1) > 0x9f);
        if (length == 4)
            valid = valid && !(lead == 0xf0 && byte(1) < 0x90) &&
                    (lead < 0xf4 || (lead == 0xf4 && byte(1) < 0x90));
        if (valid) {
            result.append(name, i, length);
            i += length;
        } else {
            result += fmt::format("%{:02X}", lead);
            ++i;
        }
    }
    return result;
}

std::string printableName(const std::string& name) {
    constexpr std::size_t kLongest = 80;
    std::string result;
    for (const char c : validUtf8(name)) {
        const auto byte = static_cast<unsigned char>(c);
        // A cut in the middle of a character would leave half of it.
        if (result.size() >= kLongest && byte >> 6 != 2) return result + "...";
        result += byte < 0x20 || byte == 0x7f ? fmt::format("\\x{:02x}", byte) : std::string(1, c);
    }
    return result;
}

}  // namespace brickyard
