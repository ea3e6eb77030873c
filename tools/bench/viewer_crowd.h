// Many viewers of one server, each with a connection of the client library, a small page cache and a way of
// its own, and a thread that waits in RemoteSource::take() as a renderer does.
//
// A viewer wishes once per `pace`: first, and every eighth time, for what its camera sees; in between for the
// pages of its view that its cache does not hold. What comes is compared with its checksum, decoded, and put
// into the cache. A wish that is due while the one before is not done waits for it, and its latencies count
// from when it was due.
#pragma once

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "client/stream_address.h"
#include "tools/bench/quantiles.h"
#include "tools/bench/served_subject.h"
#include "tools/bench/viewer_path.h"

namespace brickyard {

struct ViewerSettings {
    std::chrono::milliseconds pace{1000};
    std::uint64_t credit_bytes = 32u << 10;  // of each wish
    std::uint64_t cache_bytes = 1u << 20;    // decoded
};

struct ViewerFigures {
    std::uint64_t wishes = 0, late_wishes = 0;  // late: the one before was not done when it was due
    std::uint64_t pages = 0, blocks = 0, bytes = 0;
    std::uint64_t errors = 0;
    std::string first_error;
    // In milliseconds from when a wish was due to a page of it being taken: every one, and each wish's first.
    // Of a viewer's very first wish only its first page, and apart.
    std::vector<float> page_ms, first_ms, cold_ms;

    void add(ViewerFigures&& other);
    nlohmann::json json(double seconds) const;
};

class ViewerCrowd {
public:
    // Connects `count` viewers; returns when all have a frame open, or gave up. `subject` and `paths` outlive
    // the crowd.
    ViewerCrowd(const StreamAddress& address, const ServedSubject& subject,
                const std::vector<ViewerPath>& paths, std::size_t count, const ViewerSettings& settings);
    // Ends what still runs.
    ~ViewerCrowd();
    ViewerCrowd(const ViewerCrowd&) = delete;
    ViewerCrowd& operator=(const ViewerCrowd&) = delete;

    // They start to wish, evenly over one pace.
    void begin();
    // They stop, and disconnect. The sum of what they saw. REQUIRES: begun.
    ViewerFigures end();

private:
    class Viewer;
    struct Shared;
    std::unique_ptr<Shared> shared_;
    std::vector<std::unique_ptr<Viewer>> viewers_;
};

}  // namespace brickyard
