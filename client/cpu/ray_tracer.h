// One pixel from its first cut to its last: rounds of integrate, composite, split. docs/design.md, section "A
// ray". Immutable; each PixelRay is worked on by one thread at a time.
#pragma once

#include <optional>

#include "client/cpu/ray_composite.h"
#include "client/cpu/shadow_tracer.h"

namespace brickyard {

struct PixelRay {
    bool begun = false;
    WorldRay world;
    double offset = 0;  // world distance from the eye to world.origin
    ChannelRay density;
    std::optional<ChannelRay> emission;
};

class RayTracer {
public:
    explicit RayTracer(const RenderPlan& plan);

    // The pixel's first cut. advance() begins by itself.
    void begin(std::uint32_t x, std::uint32_t y, PixelRay& ray) const;
    // Goes on with a pixel as far as the pages allow. kFinal: `out` is its last value. kDrawn: pages are
    // missing, and `out` is the pixel of the last cut that was whole. kMissing: there is no such cut yet.
    enum class Progress { kMissing, kDrawn, kFinal };
    Progress advance(std::uint32_t x, std::uint32_t y, PixelRay& ray, const RayContext& context,
                     RayComposite& out) const;
    // The pixel as it can be drawn now, with the errors of what stands in for missing pages.
    RayComposite provisional(const PixelRay& ray, const RayContext& context) const;
    // Whether a page that cannot be had has a part in it.
    static bool hasFailed(const PixelRay& ray);

private:
    void beginAtMedium(PixelRay& ray) const;
    bool lightAll(PixelRay& ray, const RayContext& context) const;
    bool goodEnough(const RayComposite& composite, bool with_light) const;
    // Splits what must be split. kDone: nothing is left that could help.
    enum class Refined { kSplit, kDone, kWaiting };
    Refined refine(PixelRay& ray, const RayComposite& composite, const RayContext& context) const;

    const RenderPlan& plan_;
    bool eye_is_far_;
    double estimate_target_;
    double opaque_depth_;
    std::optional<ShadowTracer> shadows_;
};

}  // namespace brickyard
