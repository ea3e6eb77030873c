// What the operating system said, as one line for a person.
#pragma once

#include <filesystem>

#include "core/result.h"

namespace brickyard {

// "PATH: cannot WHAT: reason"; a full disk and a used-up quota say what to do. `error` is an errno.
tl::unexpected<Error> ioError(const char* what, const std::filesystem::path& path, int error);

}  // namespace brickyard
