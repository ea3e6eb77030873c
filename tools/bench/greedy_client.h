// A client that takes all it can get: it wishes for every page of a frame with endless credit, reads as fast
// as it can, and wishes again at once. A thread of its own reads, and one more sends where it floods.
#pragma once

#include <atomic>
#include <cstdint>
#include <memory>
#include <thread>

#include "core/result.h"
#include "tools/bench/raw_stream.h"
#include "tools/bench/served_subject.h"
#include "tools/bench/viewer_path.h"

namespace brickyard {

enum class Greed {
    kEverything,  // the next wish when the one before is done
    kFlood,       // wishes as fast as they go out: every page, and in turn what a camera sees
};

class GreedyClient {
public:
    // Connects and begins. `subject` and `path` outlive it. Errors: kIo, kRefused.
    static Result<std::unique_ptr<GreedyClient>> start(std::uint16_t port, const std::string& dataset,
                                                       const ServedSubject& subject, const ViewerPath& path,
                                                       Greed greed);
    ~GreedyClient();
    GreedyClient(const GreedyClient&) = delete;
    GreedyClient& operator=(const GreedyClient&) = delete;

    std::uint64_t bytes() const { return bytes_; }    // received so far, as on the wire
    std::uint64_t wishes() const { return wishes_; }  // sent so far
    // It was cut off by the server, or could not go on.
    bool failed() const { return failed_; }

private:
    GreedyClient(RawStream stream, const SubjectFrame& frame, const ViewerPath& path, Greed greed);
    bool wish();
    void read();
    void flood();

    RawStream stream_;
    StreamHeader every_, seen_;
    const Greed greed_;
    std::uint64_t epoch_ = 0;  // of the thread that sends
    std::atomic<std::uint64_t> bytes_{0}, wishes_{0};
    std::atomic<bool> over_{false}, failed_{false};
    std::jthread reader_, sender_;
};

// The wish for a list of pages over a frame of dataset 1.
StreamHeader listWish(const SubjectFrame& frame, const PageWish& list, std::uint64_t epoch);

}  // namespace brickyard
