// Where pages come from: a local folder or a server. The renderer cannot tell them apart.
//
// The wish list is the protocol (DESIGN.md, idea 3): the newest wish replaces the older one, nothing is owed.
// One thread drives a source; what happens behind it (a network thread) is its own business.
#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "core/page_wish.h"
#include "core/result.h"
#include "proto/dataset.pb.h"

namespace brickyard {

struct Arrival {
    WishedPage page;
    // Stored bytes as they lie in the frame file, not yet verified; or why it cannot be had (that page only).
    Result<std::vector<std::byte>> bytes;
};

struct SourceCounters {
    std::uint64_t bytes_streamed =
        0;  // payload bytes of pages and blocks received; 0 for a local source's index reads
    std::uint64_t pages_streamed = 0;   // bricks
    std::uint64_t blocks_streamed = 0;  // tree blocks
    std::uint64_t round_trips = 0;      // times the client waited for an answer (open, frame, wishes)
};

class BrickSource {
public:
    virtual ~BrickSource() = default;

    virtual const Manifest& manifest() const = 0;
    // The footer of a frame; later wishes are about it. Errors: kNotFound, kIo, kRefused, kTimeout, kCorrupt.
    virtual Result<FrameFooter> openFrame(std::uint32_t frame) = 0;
    // Replaces the wish before. Returns at once.
    virtual Result<void> wish(PageWish newest) = 0;
    // Waits until something of the newest wish arrives, at most until `deadline`. An empty list means that
    // the wish is done (everything sent or credit used up) or the deadline passed; `wishDone()` tells which.
    // Errors: the source as a whole is lost.
    virtual Result<std::vector<Arrival>> take(std::chrono::steady_clock::time_point deadline) = 0;
    virtual bool wishDone() const = 0;
    virtual SourceCounters counters() const = 0;
};

// A dataset folder, or ws://HOST:PORT/NAME (wss:// where TLS is built in). `token` may be empty.
// Errors: kInvalid (neither), kNotFound, kIo, kRefused, kTooNew, kTimeout.
Result<std::unique_ptr<BrickSource>> openSource(const std::string& source, const std::string& token);

}  // namespace brickyard
