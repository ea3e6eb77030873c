// What a server counts, as Prometheus reads it (GET /metrics; docs/deploy.md tells what each means). Any
// thread.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

namespace brickyard {

enum class Via { kHttp, kStream };

class Metrics {
public:
    Metrics();
    ~Metrics();

    void httpRequest(std::string_view route, unsigned status, double seconds);
    void connectionOpened(Via via);
    void connectionClosed(Via via);
    void connectionRefused(std::string_view reason);
    void pageSent(Via via, bool is_block, std::uint64_t bytes, double seconds_since_wish);
    void wishReceived(bool replaced_another);
    void diskRead(double seconds);
    void error(std::string_view kind);

    // Asked for when the metrics are read.
    struct Gauges {
        std::uint64_t queued_bytes = 0, queue_limit_bytes = 0;
        std::uint64_t wish_bytes = 0, wish_limit_bytes = 0;
        std::uint64_t block_cache_bytes = 0, block_cache_hits = 0, block_cache_misses = 0;
        std::uint64_t open_frames = 0, datasets = 0, frames = 0;
    };
    // Prometheus text format, version 0.0.4.
    std::string text(const Gauges& now) const;

private:
    struct State;
    std::unique_ptr<State> state_;
};

}  // namespace brickyard
