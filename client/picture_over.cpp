#include "client/picture_over.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <glm/geometric.hpp>

namespace brickyard {

void toRayDepth(Picture& picture, DepthKind kind, const PinholeCamera* camera) {
    assert(kind == DepthKind::kRay || camera);
    std::size_t i = 0;
    for (std::uint32_t y = 0; y < picture.height; ++y)
        for (std::uint32_t x = 0; x < picture.width; ++x, ++i) {
            float& depth = picture.pixels[i].depth;
            // Not a number is not above 0 either.
            if (!(depth > 0) || !std::isfinite(depth)) {
                depth = 0;
                continue;
            }
            if (kind == DepthKind::kPlane)
                depth = float(double(depth) / glm::dot(camera->ray(x, y).direction, camera->forward()));
        }
}

Picture enlarged(const Picture& picture, std::uint32_t edge) {
    Picture out(picture.width * edge, picture.height * edge);
    for (std::uint32_t y = 0; y < out.height; ++y)
        for (std::uint32_t x = 0; x < out.width; ++x)
            out.pixels[std::size_t(y) * out.width + x] =
                picture.pixels[std::size_t(y / edge) * picture.width + x / edge];
    return out;
}

void composeOver(Picture& front, const Picture& behind) {
    assert(front.width == behind.width && front.height == behind.height);
    for (std::size_t i = 0; i < front.pixels.size(); ++i) {
        Pixel& f = front.pixels[i];
        const Pixel& b = behind.pixels[i];
        // Nothing shows through an opaque pixel, whatever it is: 0 times infinity would not be 0.
        const float through = 1 - f.alpha;
        float brightest = 0;
        for (std::size_t c = 0; c < 3; ++c) {
            if (through > 0) f.radiance[c] += through * b.radiance[c];
            brightest = std::max(brightest, std::abs(b.radiance[c]));
        }
        const float alpha = through > 0 ? f.alpha + through * b.alpha : f.alpha;
        const bool ours = f.alpha > 0 && (!(b.depth > 0) || f.alpha >= 0.5f * alpha);
        if (!ours) f.depth = b.depth;
        f.alpha = alpha;
        // An alpha without an error has none, however bright the sun behind it.
        const float covered = std::abs(1 - b.alpha);
        const auto carry = [&](float& of_radiance, float& of_alpha) {
            if (!(of_alpha > 0)) return;
            of_radiance += of_alpha * brightest;
            of_alpha *= covered;
        };
        carry(f.bound_radiance, f.bound_alpha);
        carry(f.estimate_radiance, f.estimate_alpha);
    }
}

}  // namespace brickyard
