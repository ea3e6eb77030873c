#include "client/stream_address.h"

#include <fmt/format.h>

#include <charconv>

#include "core/percent_code.h"

namespace brickyard {
namespace {

// That of a proxy in front, as everybody's wss:// has it.
constexpr std::uint16_t kSecurePort = 443;

tl::unexpected<Error> malformed(std::string_view url, std::string_view what) {
    return fail(
        ErrorCode::kInvalid,
        fmt::format("{}: {}; write ws://HOST:PORT/NAME, for example ws://127.0.0.1:8750/plume", url, what));
}

}  // namespace

Result<StreamAddress> StreamAddress::parse(std::string_view url) {
    constexpr std::string_view kScheme = "ws://", kSecure = "wss://";
    const bool secure = url.starts_with(kSecure);
    if (!secure && !url.starts_with(kScheme)) return malformed(url, "not an address of a server");
    std::string_view rest = url.substr(secure ? kSecure.size() : kScheme.size());
    const auto slash = rest.find('/');
    std::string_view authority = rest.substr(0, slash);
    std::string_view name = slash == std::string_view::npos ? std::string_view{} : rest.substr(slash + 1);

    StreamAddress address;
    address.secure = secure;
    if (secure) address.port = kSecurePort;
    std::string_view port;
    if (authority.starts_with('[')) {
        const auto bracket = authority.find(']');
        if (bracket == std::string_view::npos)
            return malformed(url, "an IPv6 address has no closing bracket");
        address.host = authority.substr(1, bracket - 1);
        port = authority.substr(bracket + 1);
    } else {
        const auto colon = authority.find(':');
        address.host = authority.substr(0, colon);
        port = colon == std::string_view::npos ? std::string_view{} : authority.substr(colon);
    }
    if (address.host.empty()) return malformed(url, "no host");
    if (!port.empty()) {
        if (port.front() != ':') return malformed(url, "no ':' before the port");
        port.remove_prefix(1);
        const auto [end, error] = std::from_chars(port.data(), port.data() + port.size(), address.port);
        if (error != std::errc{} || end != port.data() + port.size() || address.port == 0)
            return malformed(url, "the port is not a number from 1 to 65535");
    }

    while (name.ends_with('/')) name.remove_suffix(1);
    if (name.empty()) return malformed(url, "no dataset is named");
    if (name.find('/') != std::string_view::npos) return malformed(url, "a dataset's name has no '/'");
    auto decoded = percentDecode(name);
    if (!decoded) return malformed(url, decoded.error().message);
    address.dataset = std::move(*decoded);
    return address;
}

std::string StreamAddress::hostAndPort() const {
    return host.find(':') == std::string::npos ? fmt::format("{}:{}", host, port)
                                               : fmt::format("[{}]:{}", host, port);
}

std::string StreamAddress::url() const {
    return fmt::format("{}://{}/{}", secure ? "wss" : "ws", hostAndPort(), percentEncode(dataset));
}

}  // namespace brickyard
