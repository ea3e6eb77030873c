// Where a server writes what it does: events with named values, a line each on stderr, for people
//   [2026-11-26 01:28:10.764] [info] stream opened id=1 tls=TLSv1.3
// or for machines
//   {"time":"2026-11-26T01:28:10.764Z","level":"info","event":"stream opened","id":1,"tls":"TLSv1.3"}
// Any thread.
#pragma once

#include <spdlog/logger.h>

#include <cstdint>
#include <initializer_list>
#include <memory>
#include <string_view>
#include <utility>
#include <variant>

#include "server/server_options.h"

namespace brickyard {

// Critical, error, warn (the default), info (a line a stream), debug (a line a request).
using LogLevel = spdlog::level::level_enum;

class ServerLog {
public:
    using Value = std::variant<std::string_view, std::uint64_t>;
    using Field = std::pair<const char*, Value>;

    explicit ServerLog(const ServerOptions& options);

    // Whether an event of this level is written at all: not worth preparing otherwise.
    bool wants(LogLevel level) const { return logger_->should_log(level); }
    // Values may come from a peer: control characters and quotes in them are escaped.
    void write(LogLevel level, std::string_view event, std::initializer_list<Field> fields = {}) const;

private:
    const LogFormat format_;
    const std::shared_ptr<spdlog::logger> logger_;
};

}  // namespace brickyard
