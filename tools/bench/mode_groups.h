// The options of a picture that `bench trade` holds against each other, as requests. Plain values.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "client/renderer.h"
#include "tools/bench/bench_cache.h"

namespace brickyard {

// Names of all groups, as `--modes` takes them.
inline constexpr const char* kModeGroups[] = {"presets",       "light", "shadows",  "kernels",
                                              "supersampling", "path",  "transfer", "environment",
                                              "surface",       "motion"};

struct ModeRow {
    std::string name;
    RenderRequest request;
    std::size_t truth = 0;                     // index in ModeGroup::truths
    std::optional<std::size_t> is_truth = {};  // that picture itself; there is no request then
    std::uint32_t grid_edge = 1;               // as ModeTruth's
    // Its estimate speaks of another truth: a pixel's centre, another kernel.
    bool silent = false;
};

// A picture that others are held to.
struct ModeTruth {
    RenderRequest request;
    std::uint32_t grid_edge = 1;  // so many rays along each edge of a pixel: its picture is as much larger
};

// Options that differ in one thing. Seconds are relative to one of them.
struct ModeGroup {
    std::string name;
    std::string truth_is;  // in words
    std::string baseline;  // name of the row
    bool of_alpha = false;
    std::vector<ModeTruth> truths;
    std::vector<ModeRow> rows;
};

// What a group's pictures are made of.
struct ModeSubject {
    std::string density;
    Camera camera;
    double density_scale = 1;
    FrameFooter footer;
    std::string baked;  // channel of the sun's light; empty where nothing was baked
};

// The sun that every lit picture has, as a scene to bake.
Scene sunlitScene(const ModeSubject& subject);

// Those of `names`; all where it is empty. A group that needs a channel that the dataset lacks is left out.
// Pictures have at most `most_edge` pixels a side, those that take long fewer.
std::vector<ModeGroup> modeGroups(const ModeSubject& subject, std::uint32_t most_edge,
                                  const std::vector<std::string>& names);

}  // namespace brickyard
