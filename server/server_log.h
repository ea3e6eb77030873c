// Where a server writes what it does: lines on stderr, for people or for machines. Any thread.
#pragma once

#include <spdlog/logger.h>

#include <memory>

#include "server/server_options.h"

namespace brickyard {

// Levels: critical, error, warn (the default), info (a line a stream), debug (a line a request).
std::shared_ptr<spdlog::logger> makeServerLog(const ServerOptions& options);

}  // namespace brickyard
