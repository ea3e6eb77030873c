// A server of a test's own, and whether it is as it was before somebody came.
#pragma once

#include <fmt/format.h>
#include <gmock/gmock.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <thread>

#include "raw_socket.h"
#include "server/server.h"

namespace brickyard {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;
using std::chrono::seconds;

// Whether it holds before the time is over; asks again and again.
inline bool comesTrue(const std::function<bool()>& holds, milliseconds patience = seconds(10)) {
    const auto end = Clock::now() + patience;
    while (!holds()) {
        if (Clock::now() > end) return false;
        std::this_thread::sleep_for(milliseconds(20));
    }
    return true;
}

inline std::size_t openDescriptors() {
    std::size_t count = 0;
    for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator("/proc/self/fd")) ++count;
    return count;
}

class LiveServer {
public:
    explicit LiveServer(const std::vector<std::filesystem::path>& datasets, ServerOptions options = {}) {
        options.port = 0;
        auto catalog = Catalog::open(datasets, 64, 1u << 20);
        EXPECT_TRUE(catalog) << catalog.error().message;
        if (!catalog) return;
        auto server = Server::start(std::move(*catalog), options);
        EXPECT_TRUE(server) << server.error().message;
        if (server) server_ = std::move(*server);
    }
    Server& server() { return *server_; }
    Server* operator->() { return server_.get(); }
    std::uint16_t port() const { return server_->port(); }
    RawReply get(std::string_view target, std::string_view headers = "") const {
        return request(port(), "GET", target, headers);
    }
    bool isHealthy() const { return get("/healthz").status == 200; }
    // A sample of /metrics by its name with its labels; -1 where it is not there.
    double metric(const std::string& name) const {
        const std::string text = "\n" + get("/metrics").body;
        const auto at = text.find("\n" + name + " ");
        return at == std::string::npos ? -1 : std::strtod(text.c_str() + at + 1 + name.size(), nullptr);
    }
    // Nobody but who asks is connected, and nothing is held for anybody.
    bool isQuiet() const {
        return metric(R"(brickyard_connections{kind="stream"})") == 0 &&
               metric(R"(brickyard_connections{kind="http"})") == 1 &&
               metric("brickyard_queued_bytes") == 0 && metric("brickyard_wish_bytes") == 0;
    }

private:
    std::unique_ptr<Server> server_;
};

}  // namespace brickyard
