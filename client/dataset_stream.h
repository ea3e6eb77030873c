// One source's part of a connection: its dataset, its frame, its wish, and what came for it. Guarded by the
// mutex of the ServerLink that it belongs to.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>
#include <string>

#include "client/brick_source.h"
#include "client/wish_message.h"
#include "core/result.h"
#include "proto/stream.pb.h"

namespace brickyard {

// Without a number it is the first frame there is.
struct FrameOpening {
    std::optional<std::uint32_t> frame;
    std::uint64_t number = 0;  // tells an answer to an older question from one to this
    bool early = false;        // asked with the greeting: openFrame() has not been called for it yet
    std::optional<Result<FrameFooter>> answer;
};

struct DatasetStream {
    DatasetStream(std::string name, std::optional<StartHint> hint)
        : dataset(std::move(name)), start(std::move(hint)) {}

    const std::string dataset;
    std::optional<StartHint> start;  // until it was sent
    std::condition_variable changed;
    std::optional<Error> lost;  // this dataset; ServerLink::lost is the whole connection

    std::uint32_t dataset_id = 0;  // on the present connection; 0 until it is welcomed there
    // Both set once welcomed; the first is never changed again.
    std::shared_ptr<const Manifest> first_manifest, manifest;
    bool news = false;  // the manifest changed and nobody was told

    // The frame that is being opened.
    std::optional<FrameOpening> opening;
    std::uint64_t openings = 0;
    // The frame that is open, and whether it is on the present connection.
    std::optional<std::uint32_t> frame;
    std::uint64_t footer_xxh64 = 0;  // 0: the server did not say
    bool frame_open = false;

    // The newest wish: what of it is still to be asked for. Epoch and credit are filled in when it is sent.
    Wish wanted;
    bool done = true;
    std::optional<Error> wish_failed;
    std::uint64_t credit_granted = 0, credit_left = 0;
    std::uint64_t epoch = 0;        // of the message that carried it last
    std::uint64_t first_epoch = 0;  // of the one that carried it first; 0 before that
    PageSet had;                    // what came since then
    // It was sent with the greeting: wish() of just that takes it over.
    std::optional<StartView> early_view;
    std::optional<CameraView> early_seen;  // what the server makes of it; known with the footer
    std::chrono::steady_clock::time_point wished_at;

    std::deque<Arrival> arrivals;
    std::uint64_t queued_bytes = 0;  // Invariant: the payloads in `arrivals`
    std::uint64_t queue_limit = 0;   // what the two newest wishes granted
    std::uint64_t last_credit = 0;
    bool paused = false;  // holds back the reading: more came than was granted
    SourceCounters counters;

    void forgetWish() {
        wanted.Clear();
        done = true;
        wish_failed.reset();
        credit_granted = credit_left = first_epoch = 0;
        had.clear();
        early_view.reset();
        early_seen.reset();
    }
    void forgetArrivals() {
        arrivals.clear();
        queued_bytes = 0;
        paused = false;
    }
};

}  // namespace brickyard
