#include <fmt/format.h>

#include "client/brick_source.h"
#include "client/local_source.h"
#include "client/remote_source.h"

namespace brickyard {

Result<std::unique_ptr<BrickSource>> openSource(const std::string& source, const SourceAccess& access,
                                                const std::optional<StartHint>& start,
                                                StreamTimeouts timeouts) {
    if (source.find("://") != std::string::npos) {
        auto address = StreamAddress::parse(source);
        if (!address) return tl::unexpected(address.error());
        address->authorities = access.authorities;
        auto remote = RemoteSource::open(*address, access.token, timeouts, start);
        if (!remote) return tl::unexpected(remote.error());
        return std::move(*remote);
    }
    std::error_code error;
    if (!std::filesystem::exists(source, error))
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: no such dataset; give a .bricks folder or ws://HOST:PORT/NAME", source));
    if (!std::filesystem::is_directory(source, error))
        return fail(
            ErrorCode::kInvalid,
            fmt::format(
                "{}: not a dataset folder; make one with `brickyard convert`, or give ws://HOST:PORT/NAME",
                source));
    auto local = LocalSource::open(source);
    if (!local) return tl::unexpected(local.error());
    return std::move(*local);
}

}  // namespace brickyard
