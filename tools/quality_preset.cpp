#include "tools/quality_preset.h"

namespace brickyard {

// An error, and how many pixels a voxel may span before it must be split.
std::optional<QualitySettings> qualityPreset(const std::string& name) {
    if (name == "draft") return QualitySettings{.max_error = 0.15, .pixels_per_voxel = 4};
    if (name == "preview") return QualitySettings{.max_error = 0.05, .pixels_per_voxel = 2};
    if (name == "final") return QualitySettings{.max_error = 0.01, .pixels_per_voxel = 1};
    if (name == "reference") return QualitySettings{.reference = true};
    return std::nullopt;
}

}  // namespace brickyard
