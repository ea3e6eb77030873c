// Pictures of scenes written as JSON, of datasets made of formulas, and what tests ask of them.
#pragma once

#include <gmock/gmock.h>

#include <cmath>
#include <cstring>
#include <optional>
#include <string>
#include <vector>

#include "blob_field.h"
#include "stored_fields.h"

namespace brickyard {

// A mean and its standard error.
struct MeanOf {
    double mean = 0, error = 0;
};

class ScenePictures : public testing::Test {
protected:
    std::filesystem::path folder(const std::string& name = "test") const {
        return scratch_ / (name + ".bricks");
    }
    void store(const std::vector<const FieldSource*>& fields, int edge = 8, std::uint32_t frame = 0,
               double max_error = 0, const std::string& name = "test") {
        const auto stored = storeFields(folder(name), fields, edge, max_error, frame);
        ASSERT_TRUE(stored) << stored.error().message;
    }
    // Of the reference quality, at one ray a pixel.
    RenderRequest request(const Camera& camera, std::uint32_t edge, const std::string& scene) const {
        RenderRequest request;
        request.camera = camera;
        request.width = request.height = edge;
        request.quality.reference = true;
        request.folder = scratch_.path();
        auto read = readScene(scene);
        EXPECT_TRUE(read) << read.error().message;
        if (read) request.scene = *read;
        return request;
    }
    RenderOutcome outcomeOf(const RenderRequest& request) const {
        auto outcome = drawStored(folder(), request);
        EXPECT_TRUE(outcome) << outcome.error().message;
        return outcome ? std::move(*outcome) : RenderOutcome();
    }
    Picture draw(const RenderRequest& request) const {
        RenderOutcome outcome = outcomeOf(request);
        EXPECT_TRUE(outcome.final);
        return std::move(outcome.picture);
    }
    static Picture path(RenderRequest request, std::uint32_t samples, const ScenePictures& of) {
        request.path = true;
        request.samples = samples;
        return of.draw(request);
    }
    // By the general renderer, where the beams would do: two lights of half the power are no simple scene,
    // nor is a medium in a list.
    static bool same(const Picture& a, const Picture& b) {
        return a.pixels.size() == b.pixels.size() &&
               std::memcmp(a.pixels.data(), b.pixels.data(), a.pixels.size() * sizeof(Pixel)) == 0;
    }

    ScratchFolder scratch_;
};

// Largest difference of radiance or alpha.
inline double worstDifference(const Picture& a, const Picture& b) {
    double worst = 0;
    EXPECT_EQ(a.pixels.size(), b.pixels.size());
    for (std::size_t i = 0; i < std::min(a.pixels.size(), b.pixels.size()); ++i) {
        worst = std::max(worst, std::abs(double(a.pixels[i].alpha - b.pixels[i].alpha)));
        for (std::size_t c = 0; c < 3; ++c)
            worst = std::max(worst, std::abs(double(a.pixels[i].radiance[c] - b.pixels[i].radiance[c])));
    }
    return worst;
}

// Of a number of each pixel, with the pixels' own estimates of the error of their radiance.
template <class Number>
MeanOf meanOf(const Picture& picture, Number number) {
    MeanOf out;
    const auto count = double(picture.pixels.size());
    for (const Pixel& pixel : picture.pixels) {
        out.mean += number(pixel) / count;
        out.error += std::pow(double(pixel.estimate_radiance) / count, 2);
    }
    out.error = std::sqrt(out.error);
    return out;
}

}  // namespace brickyard
