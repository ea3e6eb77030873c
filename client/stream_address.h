// ws://HOST:PORT/NAME, or wss:// for TLS, taken apart. Plain value.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <string_view>

#include "core/result.h"

namespace brickyard {

struct StreamAddress {
    std::string host;  // without the brackets of an IPv6 address
    std::uint16_t port = 8750;
    std::string dataset;                // decoded
    bool secure = false;                // wss://
    std::filesystem::path authorities;  // PEM: whose certificates are believed; empty: those of this machine

    // Errors: kInvalid (says what an address looks like).
    static Result<StreamAddress> parse(std::string_view url);
    // "127.0.0.1:8750", "[::1]:8750".
    std::string hostAndPort() const;
    // As a user writes it.
    std::string url() const;
};

}  // namespace brickyard
