// What is drawn where a scene names neither medium nor surface, and where `brickyard scene` begins. Pure
// functions, any thread.
#pragma once

#include <cstdint>
#include <optional>

#include "proto/dataset.pb.h"
#include "proto/scene.pb.h"

namespace brickyard {

// The one scalar channel of class "level set" that has active voxels; nothing where there is none, or more.
std::optional<std::uint32_t> onlyLevelSet(const FrameFooter& frame);

// The channel where it is 0: grey, with a soft highlight, and darker where a tenth of its box's diagonal
// closes it in. REQUIRES: it has active voxels.
Surface defaultSurface(const ChannelFooter& channel);

// A frame whose one channel with scalars in it is a level set, with values on both sides of 0, is a surface
// under a key light and a faint sky. Any other is a medium that says nothing of itself, without a light.
Scene defaultScene(const FrameFooter& frame);

// Light from the upper left of who looks at `camera`'s target, and a faint sky.
void addStudioLights(const Camera& camera, double key_irradiance, double sky_radiance, Scene& scene);

}  // namespace brickyard
