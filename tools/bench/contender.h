// One way to draw a picture, timed beside others. Peers take turns, so that a busy moment of the machine hits
// them all alike.
#pragma once

#include <functional>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "core/result.h"
#include "tools/bench/picture_error.h"
#include "tools/bench/timing.h"

namespace brickyard {

struct Contender {
    std::string name;
    // Draws once and gives the seconds of that; adds the picture's error to `error` where it is not null.
    std::function<Result<double>(PictureError* error)> draw;
    unsigned max_rounds = 1000;  // the slow ones sit out the later rounds
    bool ours = false;
    double peer_step = 0;  // of a marcher, in voxels
    Timing timing;
    PictureError error;
};

// `rounds` rounds, each contender once in each. Errors: the first of a contender.
Result<void> race(std::vector<Contender>& contenders, unsigned rounds);

// The quickest of ours with at most this rms error; nullptr where none is as exact.
const Contender* cheapestOfOurs(const std::vector<Contender>& contenders, double rms);

// Name, median and best seconds, million rays a second, error.
nlohmann::json toJson(const Contender& contender);

}  // namespace brickyard
