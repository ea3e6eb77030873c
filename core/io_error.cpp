#include "core/io_error.h"

#include <fmt/format.h>

#include <cerrno>
#include <system_error>

namespace brickyard {

tl::unexpected<Error> ioError(const char* what, const std::filesystem::path& path, int error) {
    if (error == ENOSPC || error == EDQUOT)
        return fail(
            ErrorCode::kIo,
            fmt::format("{}: no space left on the disk (or quota); free some and run the same command again",
                        path.string()));
    return fail(error == ENOENT ? ErrorCode::kNotFound : ErrorCode::kIo,
                fmt::format("{}: cannot {}: {}", path.string(), what, std::system_category().message(error)));
}

}  // namespace brickyard
