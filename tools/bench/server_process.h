// `brickyard serve` as a child process on a free port of 127.0.0.1, and what it costs. One thread.
#pragma once

#include <sys/types.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "client/stream_address.h"
#include "core/result.h"

namespace brickyard {

struct ServerUsage {
    double cpu_seconds = 0;               // user and system, since its start
    std::uint64_t resident_bytes = 0;     // now
    std::uint64_t peak_bytes = 0;         // the most so far
    std::uint64_t errors = 0;             // brickyard_errors_total of all kinds
    std::uint64_t refused = 0;            // connections
    std::uint64_t wishes = 0, pages = 0;  // received; bricks and tree blocks sent
};

class ServerProcess {
public:
    // Serves the dataset `folder`; returns when it listens. `options` are more of its own. Its stderr goes to
    // a file in `scratch`. Errors: kIo (it does not start; the message has what it said).
    static Result<std::unique_ptr<ServerProcess>> start(const std::filesystem::path& folder,
                                                        const std::filesystem::path& scratch,
                                                        std::vector<std::string> options = {});
    // Asks it to stop, and waits for its end.
    ~ServerProcess();
    ServerProcess(const ServerProcess&) = delete;
    ServerProcess& operator=(const ServerProcess&) = delete;

    std::uint16_t port() const { return port_; }
    StreamAddress address() const {
        return {.host = "127.0.0.1", .port = port_, .dataset = dataset_, .authorities = {}};
    }
    // From /proc and from its own GET /metrics. Errors: kIo (it has ended, or does not answer).
    Result<ServerUsage> usage() const;

private:
    ServerProcess() = default;
    Result<void> awaitPort();

    pid_t child_ = -1;
    int out_ = -1;  // its stdout
    std::uint16_t port_ = 0;
    std::string dataset_;
    std::filesystem::path err_;
};

// What one benchmark reports of its server: the difference of two usages, over `seconds`.
nlohmann::json usageJson(const ServerUsage& before, const ServerUsage& after, double seconds);
std::string usageText(const ServerUsage& before, const ServerUsage& after, double seconds);

}  // namespace brickyard
