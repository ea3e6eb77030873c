// Which way a picture is drawn: what the beams cannot draw must not reach them, for they would leave it out.

#include "client/trace/trace_picture.h"

#include <gtest/gtest.h>

#include <string>

#include "client/scene.h"

namespace brickyard {
namespace {

RenderRequest requestOf(const std::string& scene) {
    RenderRequest request;
    Result<Scene> read = readScene(scene);
    EXPECT_TRUE(read.has_value()) << scene;
    if (read) request.scene = *read;
    return request;
}

TEST(DrawnByBeams, WhatWasDrawnBeforeStillIs) {
    for (const char* scene :
         {R"({})", R"({"medium": {"density": "smoke", "density_scale": 4, "anisotropy": 0.3}})",
          R"({"medium": {"emission": {"channel": "flame", "scale": 9, "color": [1, 0.3, 0.1]}}})",
          R"({"lights": [{"direction": [0, 0, -1], "irradiance": [1, 1, 1]}], "background": [0, 0, 0]})",
          R"({"datasets": [{"name": "a", "source": "a.bricks"}]})"})
        EXPECT_TRUE(drawnByBeams(requestOf(scene))) << scene;
}

TEST(DrawnByBeams, WhatTheyWouldLeaveOutIsNot) {
    for (const char* scene :
         {R"({"datasets": [{"source": "a.bricks", "transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, 2,0,0,1]}]})",
          R"({"datasets": [{"source": "a.bricks", "transform": [1, 0]}]})",
          R"({"lights": [{"direction": [0, 0, -1], "baked": "light.0"}]})",
          R"({"lights": [{"direction": [0, 0, -1], "shadows": "none"}]})",
          R"({"lights": [{"direction": [0, 0, -1]}, {"direction": [0, 1, 0]}]})",
          R"({"lights": [{"type": "point", "position": [0, 0, 0]}]})", R"({"media": [{}]})",
          R"({"medium": {"phase": "rayleigh"}})", R"({"medium": {"filter": "bspline"}})",
          R"({"medium": {"transfer": {"preset": "bone"}}})",
          R"({"medium": {"emission": {"channel": "t", "black_body": {}}}})", R"({"surfaces": [{}]})",
          R"({"clip": {"planes": [{"point": [0, 0, 0], "normal": [0, 0, 1]}]}})",
          R"({"medium": {"velocity": "v"}, "shutter": {"open": 0, "close": 1}})"})
        EXPECT_FALSE(drawnByBeams(requestOf(scene))) << scene;
    RenderRequest request;
    request.path = true;
    EXPECT_FALSE(drawnByBeams(request));
    request = {};
    request.samples = 3;
    EXPECT_FALSE(drawnByBeams(request));
    request = {};
    request.filter = FieldFilter::kNearest;
    EXPECT_FALSE(drawnByBeams(request));
    request = {};
    request.shadows = ShadowMethod::kExact;
    EXPECT_FALSE(drawnByBeams(request));
}

}  // namespace
}  // namespace brickyard
