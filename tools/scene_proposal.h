// A scene that shows a dataset without being tuned: what it holds decides how it is drawn, its values decide
// how thick and how bright. Reads at most some million samples of each channel.
#pragma once

#include <optional>

#include "core/dataset.h"
#include "proto/scene.pb.h"

namespace brickyard {

struct SceneProposal {
    Scene scene;
    // How well the velocity's unit is known (VelocityFit::explained); nothing where one frame had to do.
    std::optional<double> velocity_explained;
};

// Errors: kNotFound (no such frame, nothing in it that could be drawn); those of FieldReader.
Result<SceneProposal> proposeScene(const Dataset& dataset, std::uint32_t frame);

}  // namespace brickyard
