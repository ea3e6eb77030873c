#include "tools/numbered_name.h"

namespace brickyard {

std::filesystem::path numberedName(const std::string& pattern, std::uint32_t frame) {
    const auto place = pattern.find('%');
    const auto end = pattern.find('d', place);
    if (place == std::string::npos || end == std::string::npos) return pattern;
    std::size_t digits = 0;
    for (const char c : pattern.substr(place + 1, end - place - 1)) {
        if (c < '0' || c > '9' || digits > 20) return pattern;
        digits = digits * 10 + std::size_t(c - '0');
    }
    std::string number = std::to_string(frame);
    if (number.size() < digits) number.insert(0, digits - number.size(), '0');
    return pattern.substr(0, place) + number + pattern.substr(end + 1);
}

bool hasNumberPlace(const std::string& pattern) {
    return numberedName(pattern, 0) != numberedName(pattern, 1);
}

}  // namespace brickyard
