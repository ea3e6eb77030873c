// What a picture asks for, and what follows from it for each ray. Immutable during a picture: any thread.
#pragma once

#include <optional>

#include "client/paged_channel.h"
#include "client/scene.h"
#include "core/camera.h"

namespace brickyard {

// How exact a picture is. Reference: the finest level everywhere, integrated exactly. Otherwise each pixel is
// refined until its estimate is at most max_error / 3 (with `strict`: its bound at most max_error), or, where
// pixels_per_voxel is above 0, until its voxels project to no more than that.
struct QualitySettings {
    bool reference = false;
    bool strict = false;
    double max_error = 0.01;
    double pixels_per_voxel = 0;
};

struct RenderPlan {
    const PinholeCamera* camera = nullptr;
    const PagedChannel* density = nullptr;
    const PagedChannel* emission = nullptr;  // nullptr: nothing glows
    SceneSettings scene;
    QualitySettings quality;

    // Largest radiance that one unit of single-scattered weight can carry, before the phase function.
    glm::dvec3 scattered() const {
        return scene.light ? scene.albedo * scene.light->irradiance : glm::dvec3(0);
    }
};

// Whether the eye is so far from the medium that distances from it run out of digits. Rays then begin where
// they reach the medium (RayTracer). REQUIRES: the density channel is not empty.
bool eyeIsFar(const RenderPlan& plan);

}  // namespace brickyard
