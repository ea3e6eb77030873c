// One dataset at the edge of what numbers can say, drawn in every quality and held against the reference.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "client/renderer.h"
#include "core/field_source.h"

namespace brickyard {

// The channel `source.info().name` of frame `frame` in `dataset` is what is drawn.
struct ExtremeView {
    std::string dataset;
    std::uint32_t frame = 0;
    std::uint32_t width = 20, height = 20;
    std::optional<Camera> camera;             // absent: as the renderer frames it
    std::optional<double> density_scale = 1;  // absent: only the scale below
    std::optional<double> peak_depth = 2;     // a second picture, scaled so that the deepest ray has this
};

struct ExtremeOutcome {
    double worst_alpha = 0;           // of the reference quality, over both scales
    double worst_relative = 0;        // of alphas above 1e-37: over alpha
    std::string refusal;              // the renderer's message; empty where it draws
    std::vector<std::string> faults;  // a bound that does not hold, a layer that is not finite, ...
    double peak_depth = 0;            // of the reference, for a scale of 1
};

ExtremeOutcome drawExtreme(const FieldSource& source, const ExtremeView& view);

}  // namespace brickyard
