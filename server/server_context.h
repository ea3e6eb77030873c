// What every connection of a server shares. Outlives them all.
#pragma once

#include <spdlog/logger.h>

#include <memory>

#include "server/catalog.h"
#include "server/connection_list.h"
#include "server/server_options.h"

namespace brickyard {

struct ServerContext {
    ServerContext(std::unique_ptr<const Catalog> the_catalog, ServerOptions the_options,
                  std::shared_ptr<spdlog::logger> the_log)
        : catalog(std::move(the_catalog)),
          options(std::move(the_options)),
          log(std::move(the_log)),
          connections(options.max_connections) {}

    const std::unique_ptr<const Catalog> catalog;
    const ServerOptions options;
    const std::shared_ptr<spdlog::logger> log;
    ConnectionList connections;
};

}  // namespace brickyard
