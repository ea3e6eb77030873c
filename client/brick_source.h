// Where pages come from: a local folder or a server. The renderer cannot tell them apart.
//
// The wish list is the protocol (DESIGN.md, idea 3): the newest wish replaces the older one, nothing is owed.
// One thread drives a source; what happens behind it (a network thread) is its own business.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "client/stream_timeouts.h"
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
    std::uint64_t reconnects = 0;       // times a lost connection was made anew
};

// What a camera sees, wished before the footer is known: a CameraView with names for numbers.
struct StartView {
    std::optional<Camera> camera;  // absent: the server frames the first of the channels (frameChannel)
    std::uint32_t width = 0, height = 0;
    std::vector<std::string> channels;  // "" is the default density; those the frame has not are passed over
    float pixels_per_voxel = 1;
    std::uint64_t credit_bytes = 0;
};

// What will be asked for first. A server is told together with the greeting, so that frame and first pages
// come with its first answer: openFrame() of that frame, and a first wish that is the view, then cost no
// round trip of their own.
struct StartHint {
    std::optional<std::uint32_t> frame;  // absent: the first there is
    std::optional<StartView> view;
};

using SourceDeadline = std::chrono::steady_clock::time_point;

class BrickSource {
public:
    virtual ~BrickSource() = default;

    // The folder or the address, for messages.
    virtual std::string name() const = 0;
    // As it was when the source was opened; the reference stays good, and is never changed.
    virtual const Manifest& manifest() const = 0;
    // As it is now: frames come while a simulation runs. Any thread.
    virtual std::shared_ptr<const Manifest> latestManifest() const = 0;
    // Waits until latestManifest() is another one than when this last returned true (at first: than
    // manifest()). False where the deadline passed first. Errors: the source as a whole is lost.
    virtual Result<bool> waitForChange(SourceDeadline deadline) = 0;
    // The footer of a frame; later wishes are about it. Errors: kNotFound, kIo, kRefused, kCorrupt; kTimeout
    // (by the deadline, or where a server answers nothing).
    virtual Result<FrameFooter> openFrame(std::uint32_t frame,
                                          SourceDeadline deadline = SourceDeadline::max()) = 0;
    // Replaces the wish before. Returns at once.
    virtual Result<void> wish(PageWish newest) = 0;
    // Waits until something of the newest wish arrives, at most until `deadline`. An empty list means that
    // the wish is done (everything sent or credit used up) or the deadline passed; `wishDone()` tells which.
    // The same page may come twice. Errors: the source as a whole is lost; kTimeout (a server that sends
    // nothing for long, or stays away).
    virtual Result<std::vector<Arrival>> take(SourceDeadline deadline) = 0;
    virtual bool wishDone() const = 0;
    virtual SourceCounters counters() const = 0;
};

// What a client shows a server, and what it wants to be shown.
struct SourceAccess {
    SourceAccess(std::string the_token = {}, std::filesystem::path the_authorities = {})
        : token(std::move(the_token)), authorities(std::move(the_authorities)) {}
    SourceAccess(const char* the_token) : token(the_token) {}
    std::string token;  // empty where the server asks for none
    std::filesystem::path
        authorities;  // of wss://, PEM: whose certificates are believed; empty: this machine's
};

// A dataset folder, or ws://HOST:PORT/NAME, or wss:// for TLS. `start` and
// `timeouts` are for servers; a folder needs neither.
// Errors: kInvalid (neither), kNotFound, kIo, kRefused, kTooNew, kTimeout.
Result<std::unique_ptr<BrickSource>> openSource(const std::string& source, const SourceAccess& access,
                                                const std::optional<StartHint>& start = {},
                                                StreamTimeouts timeouts = {});

}  // namespace brickyard
