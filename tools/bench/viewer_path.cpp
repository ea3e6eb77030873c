#include "tools/bench/viewer_path.h"

#include <glm/geometric.hpp>

#include "core/camera_framing.h"
#include "tools/bench/fly_path.h"

namespace brickyard {
namespace {

constexpr int kPathsPerFrame = 6;
constexpr int kStations = 48;
// A station lists no more: with a cache of a megabyte nobody gets further.
constexpr std::uint64_t kStationBytes = 1u << 20;
// The ways lie on cones round the vertical: so far up or down, of the distance.
constexpr double kLowest = -0.5, kHighest = 0.7;

Camera raised(const Camera& framing, double height) {
    Camera camera = framing;
    glm::dvec3 eye, target, up;
    for (int a = 0; a < 3; ++a) eye[a] = framing.eye(a), target[a] = framing.target(a), up[a] = framing.up(a);
    const double distance = glm::length(eye - target);
    eye = target + distance * glm::normalize((eye - target) / distance + height * glm::normalize(up));
    for (int a = 0; a < 3; ++a) camera.set_eye(a, eye[a]);
    return camera;
}

}  // namespace

Result<std::vector<ViewerPath>> makeViewerPaths(const ServedSubject& subject) {
    std::vector<ViewerPath> paths;
    for (std::size_t f = 0; f < subject.frames.size(); ++f) {
        const SubjectFrame& frame = subject.frames[f];
        const Camera framing = frameChannel(frame.footer(), double(kViewerWidth) / double(kViewerHeight));
        for (int p = 0; p < kPathsPerFrame; ++p) {
            ViewerPath& path = paths.emplace_back();
            path.frame = f;
            const double height = kLowest + (kHighest - kLowest) * double(p) / double(kPathsPerFrame - 1);
            for (int s = 0; s < kStations; ++s) {
                ViewerStation& station = path.stations.emplace_back();
                station.camera = flyCamera(raised(framing, height), double(s) / kStations);
                const Result<PinholeCamera> camera =
                    PinholeCamera::create(station.camera, kViewerWidth, kViewerHeight);
                if (!camera) return tl::unexpected(camera.error());
                Result<std::vector<DescentStep>> steps = describeView(
                    *camera, frame.footer(), frame.channel, int(frame.reader->footer().brick_edge()),
                    [&](std::uint32_t block) { return frame.block(block); }, {1, kStationBytes});
                if (!steps) return tl::unexpected(steps.error());
                station.steps = std::move(*steps);
            }
        }
    }
    return paths;
}

}  // namespace brickyard
