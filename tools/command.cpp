#include "tools/command.h"

#include <fmt/core.h>

#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <string_view>

namespace brickyard {

int reportError(const std::string& command, const Error& error) {
    fmt::print(stderr, "brickyard {}: {}\n", command, error.message);
    return kExitFailed;
}

namespace {

// The exponent of 1024 that a suffix stands for; -1 for one that stands for nothing. "M", "MB" and "MiB" are
// the same.
int suffixPower(std::string_view suffix) {
    if (suffix.empty() || suffix == "B") return 0;
    constexpr std::string_view kLetters = "KMGT";
    const char letter = suffix[0] >= 'a' && suffix[0] <= 'z' ? char(suffix[0] - 'a' + 'A') : suffix[0];
    const std::size_t place = kLetters.find(letter);
    if (place == std::string_view::npos) return -1;
    suffix.remove_prefix(1);
    return suffix.empty() || suffix == "B" || suffix == "iB" ? int(place) + 1 : -1;
}

}  // namespace

std::vector<std::string> splitNames(const std::string& text) {
    std::vector<std::string> names;
    for (std::size_t begin = 0; begin <= text.size();) {
        const std::size_t end = std::min(text.find(',', begin), text.size());
        if (end > begin) names.push_back(text.substr(begin, end - begin));
        begin = end + 1;
    }
    return names;
}

Result<std::uint64_t> parseSize(const std::string& text) {
    const auto invalid = [&](const char* why) {
        return fail(
            ErrorCode::kInvalid,
            fmt::format("'{}' is not a size: {}; write bytes or K, M, G, T, for example 512M", text, why));
    };
    const std::size_t digits = std::min(text.find_first_not_of("0123456789."), text.size());
    const std::string_view number = std::string_view(text).substr(0, digits);
    const int power = suffixPower(std::string_view(text).substr(digits));
    if (number.empty()) return invalid("it does not start with a digit");
    if (power < 0) return invalid("its unit is unknown");

    // Whole numbers stay integers: a double would round above 2^53.
    const char* const end = number.data() + number.size();
    if (number.find('.') == std::string_view::npos) {
        std::uint64_t whole = 0;
        const auto parsed = std::from_chars(number.data(), end, whole);
        if (parsed.ec != std::errc{} || whole > UINT64_MAX >> (10 * power)) return invalid("it is too large");
        return whole << (10 * power);
    }
    double value = 0;
    const auto parsed = std::from_chars(number.data(), end, value);
    if (parsed.ec != std::errc{} || parsed.ptr != end) return invalid("its number cannot be read");
    const double bytes = std::floor(std::ldexp(value, 10 * power));
    // 2^64 is a double, and the first that does not fit.
    if (!(bytes < 0x1p64)) return invalid("it is too large");
    return std::uint64_t(bytes);
}

}  // namespace brickyard
