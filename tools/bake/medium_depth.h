// Exact optical depth through the media of one frame, all of whose finest bricks are in memory. Immutable
// once loaded: any thread.
#pragma once

#include <cstdint>
#include <glm/vec3.hpp>
#include <memory>
#include <vector>

#include "client/brick_source.h"
#include "client/frame_stream.h"
#include "client/world_settings.h"
#include "core/camera.h"
#include "core/result.h"

namespace brickyard {

class MediumDepth {
public:
    // Streams every brick that a ray at the finest level meets. `footer` and `world`: of the frame, bound to
    // each other. Errors: kUnsupported (a transfer function: its extinction is not linear in the value);
    // those of the source; kCorrupt (a page that cannot be had).
    static Result<std::unique_ptr<const MediumDepth>> load(BrickSource& source, std::uint32_t frame,
                                                           const FrameFooter& footer,
                                                           const WorldSettings& world);

    // Integral of all extinction along the ray, from 0 to `end` (world; may be infinite). Beyond kOpaque it
    // may be anything larger.
    double along(const WorldRay& ray, double end) const;
    static constexpr double kOpaque = 40;  // exp(-kOpaque) is nothing in a float next to anything

private:
    explicit MediumDepth(BrickSource& source) : stream_(source, nullptr) {}
    struct Extinction {
        const PagedChannel* channel = nullptr;
        double scale = 1;
    };
    Result<void> loadPages();

    FrameStream stream_;
    std::vector<Extinction> media_;
    WorldClip clip_;
};

}  // namespace brickyard
