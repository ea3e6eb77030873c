// A cold client's way to a picture, in real time: connects, asks, and notes when which page came and how good
// the picture is with it. The picture is drawn from a StreamTable, so that drawing costs no time of the
// client's.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "client/stream_address.h"
#include "core/camera.h"
#include "core/result.h"
#include "tools/bench/served_subject.h"
#include "tools/bench/stream_table.h"

namespace brickyard {

enum class RaceClient {
    kCameraWish,  // the server finds the pages: the whole view goes with the greeting
    kOverview,    // what `brickyard render --max-bytes` does: an overview with the greeting, then its plans
    kOverviewGreedy,  // the same with batches that double, which no program of ours does yet
    kPlans,           // the same plans from the first page on, and nothing with the greeting
    kGreedyPlans,     // the same by who knows that the server is far: batches double, and roots come first
    kBreadthFirst,    // roots, and then all that it sees of the next levels at a time
};
inline constexpr RaceClient kRaceClients[] = {RaceClient::kCameraWish,     RaceClient::kOverview,
                                              RaceClient::kOverviewGreedy, RaceClient::kPlans,
                                              RaceClient::kGreedyPlans,    RaceClient::kBreadthFirst};
const char* toString(RaceClient client);

struct RaceSetup {
    StreamAddress address;
    const SubjectFrame& frame;
    const StreamTable& table;
    Camera camera;
    PinholeCamera pinhole;
    double scale = 1;       // of the density
    double stop_psnr = 40;  // of alpha
};

// When something was reached, since the client began to connect.
struct RaceMark {
    double seconds = 0;
    std::uint64_t bytes = 0;        // tree blocks and pages
    std::uint64_t round_trips = 0;  // behind the two of TCP and of WebSocket
};

struct RaceRun {
    std::optional<RaceMark> first;  // every root that a ray meets is drawn
    std::optional<RaceMark> at_30_db, at_40_db;
    RaceMark end;
    double psnr = 0;
};

// Errors: those of the source.
Result<RaceRun> runRace(const RaceSetup& setup, RaceClient client);

}  // namespace brickyard
