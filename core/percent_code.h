// Names within URLs: percent-encoding (RFC 3986, section 2.1) of UTF-8. Pure functions, any thread.
#pragma once

#include <string>
#include <string_view>

#include "core/result.h"

namespace brickyard {

// Everything but letters, digits and "-._~" becomes %XX.
std::string percentEncode(std::string_view text);
// Errors: kInvalid (a '%' without two hex digits behind it, or a zero byte).
Result<std::string> percentDecode(std::string_view text);

}  // namespace brickyard
