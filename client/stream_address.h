// ws://HOST:PORT/NAME taken apart. Plain value.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "core/result.h"

namespace brickyard {

struct StreamAddress {
    std::string host;  // without the brackets of an IPv6 address
    std::uint16_t port = 8750;
    std::string dataset;  // decoded

    // Errors: kInvalid (says what an address looks like), kUnsupported (wss://).
    static Result<StreamAddress> parse(std::string_view url);
    // "127.0.0.1:8750", "[::1]:8750".
    std::string hostAndPort() const;
    // As a user writes it.
    std::string url() const;
};

}  // namespace brickyard
