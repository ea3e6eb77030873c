// Our picture in front of another program's: what a plate or a rendered scene behind the medium adds. Pure
// functions, any thread.
#pragma once

#include "client/picture.h"
#include "core/camera.h"

namespace brickyard {

// What another program means by Z.
enum class DepthKind : std::uint8_t {
    kRay,    // world distance from the eye, as ours
    kPlane,  // along the camera's forward axis, as most renderers write it
};

// Makes Z of `picture` world distance from the eye; where it is not finite or not above 0 nothing is there,
// and it becomes 0. REQUIRES: the camera is of the picture's size, unless `kind` is kRay.
void toRayDepth(Picture& picture, DepthKind kind, const PinholeCamera* camera);

// Each pixel becomes `edge` x `edge` of its like: boxFiltered() undone.
Picture enlarged(const Picture& picture, std::uint32_t edge);

// `front` becomes itself over `behind`: both premultiplied, colour and alpha add what shows through. Z stays
// front's where that has half of the composite's opacity, as the layer Z is defined (DESIGN.md, section 9),
// or where nothing is behind; elsewhere it is behind's. `behind` is taken as exact: front's errors stay, and
// an error of its alpha counts for what shows through as well. REQUIRES: one size; behind's Z is as
// toRayDepth() leaves it, and rays of `front` ended there (RenderRequest::behind).
void composeOver(Picture& front, const Picture& behind);

}  // namespace brickyard
