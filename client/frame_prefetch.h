// The next frame of a sequence, streamed while the one before is drawn: by a thread of its own, from a source
// of its own, into a ResidentFrame that the next picture then keeps (RenderRequest::kept). What comes early
// saves time and changes no bit; what cannot be had is left to the picture to report.
//
// Frames of a sequence are alike: what is fetched stands at the places of the octree whose bricks the picture
// before has used.
#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <thread>
#include <unordered_map>

#include "client/brick_source.h"
#include "client/resident_frame.h"
#include "core/node_key.h"

namespace brickyard {

// What a picture has used of a frame, by channel and place.
struct FrameUse {
    struct Pages {
        bool whole = false, draft = false;
    };
    std::map<std::string, std::unordered_map<NodeKey, Pages, NodeKeyHash>> channels;
    int components = 1;
    std::uint64_t bytes = 0;  // stored
};
// After a picture; empty where nothing was drawn.
FrameUse useOf(const ResidentFrame& frame);

struct PrefetchRequest {
    BrickSource* source = nullptr;  // nobody else's until the end
    std::uint32_t frame = 0;
    FrameUse like;
    std::uint64_t cache_bytes = 0;  // of the picture to come
    std::uint64_t max_bytes = 0;    // streamed at most
    // What the scene does to a footer (FrameStream::begin); a failure ends it. May be empty.
    std::function<Result<void>(FrameFooter&)> bind;
    ResidentFrame* into = nullptr;  // nobody else's until the end
};

class FramePrefetch {
public:
    // Begins at once.
    explicit FramePrefetch(PrefetchRequest request);
    ~FramePrefetch() { end(); }
    FramePrefetch(const FramePrefetch&) = delete;
    FramePrefetch& operator=(const FramePrefetch&) = delete;

    // Stops it where it is, at the latest after the piece that is under way, and waits for that: source and
    // frame are the caller's again.
    void end();
    // Nothing more will come.
    bool done() const { return done_; }

private:
    void run();
    PrefetchRequest request_;
    std::atomic<bool> stop_{false}, done_{false};
    std::thread thread_;
};

}  // namespace brickyard
