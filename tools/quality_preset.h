// What `--quality NAME` means (docs/scene.md).
#pragma once

#include <optional>
#include <string>

#include "client/cpu/render_plan.h"

namespace brickyard {

inline constexpr const char* kQualityPresets[] = {"draft", "preview", "final", "reference"};

// Nothing for a name that is not among kQualityPresets.
std::optional<QualitySettings> qualityPreset(const std::string& name);

}  // namespace brickyard
