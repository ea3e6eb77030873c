// The caches that are measured, and the cameras that look at them.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "client/renderer.h"
#include "core/result.h"
#include "proto/dataset.pb.h"
#include "proto/scene.pb.h"

namespace brickyard {

struct BenchCache {
    std::string name;  // "plume_fire 24"
    std::filesystem::path file;
    std::string channel;  // of density; empty where it has none
};

// Those that we know where `data` is laid out as the project's; else the last frame of each sequence of .vdb
// files in it, at most four. Errors: kNotFound (none).
Result<std::vector<BenchCache>> findCaches(const std::filesystem::path& data);

// The same and those that have no density to draw. Errors: the same.
Result<std::vector<BenchCache>> findAllCaches(const std::filesystem::path& data);

// The files of the sequence that the cache is the last frame of, in order.
std::vector<std::filesystem::path> sequenceOf(const BenchCache& cache);

// A cache as a dataset, with the footer of its only frame.
struct BenchDataset {
    std::filesystem::path folder;
    std::uint32_t frame = 0;
    FrameFooter footer;
    ChannelFooter density;
};

// Converts into `folder`, which does not exist. `max_error` is that of a value; all channels where `channels`
// is empty. Errors: those of the conversion.
Result<BenchDataset> convertCache(const BenchCache& cache, const std::filesystem::path& folder,
                                  double max_error, const std::vector<std::string>& channels);

struct BenchView {
    std::string name;
    Camera camera;
};
// "far" (the box takes a quarter of the picture's height) and "framing" (frameChannel).
std::vector<BenchView> outsideViews(const ChannelFooter& density);
// From the middle of the box along each axis, either way: one of them is to become "inside". In a box that is
// mostly empty some of them see nothing.
std::vector<Camera> insideCameras(const ChannelFooter& density);

// As `brickyard render --camera` takes it.
nlohmann::json cameraJson(const Camera& camera);

// One picture of the dataset from a source that is opened for it. Errors: those of the renderer.
Result<RenderOutcome> renderDataset(const BenchDataset& dataset, RenderRequest request);

}  // namespace brickyard
