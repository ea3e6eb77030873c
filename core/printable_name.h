// Names that came from a file, as text that is safe to store and to show. Pure functions, any thread.
#pragma once

#include <string>

namespace brickyard {

// `name` with every byte that is not part of valid UTF-8 written %XX.
std::string validUtf8(const std::string& name);

// A name as part of a one-line message: control characters escaped, long ones cut.
std::string printableName(const std::string& name);

}  // namespace brickyard
