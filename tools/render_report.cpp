#include "tools/render_report.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "tools/command.h"

namespace brickyard {

namespace {

struct PictureErrors {
    double max_bound = 0, sum_bound = 0, max_estimate = 0, sum_estimate = 0;
    double max_alpha_bound = 0, max_alpha_estimate = 0, sum_alpha = 0;
};

PictureErrors errorsOf(const Picture& picture) {
    PictureErrors e;
    for (const Pixel& p : picture.pixels) {
        const double bound = double(std::max(p.bound_alpha, p.bound_radiance));
        const double estimate = double(std::max(p.estimate_alpha, p.estimate_radiance));
        e.max_bound = std::max(e.max_bound, bound);
        e.max_estimate = std::max(e.max_estimate, estimate);
        e.max_alpha_bound = std::max(e.max_alpha_bound, double(p.bound_alpha));
        e.max_alpha_estimate = std::max(e.max_alpha_estimate, double(p.estimate_alpha));
        e.sum_bound += bound;
        e.sum_estimate += estimate;
        e.sum_alpha += double(p.alpha);
    }
    return e;
}

// An infinite bound is none.
nlohmann::json boundOrNull(double bound) {
    return std::isfinite(bound) ? nlohmann::json(bound) : nlohmann::json(nullptr);
}

nlohmann::json toJson(const RenderOutcome& outcome, const PictureErrors& errors) {
    const double pixels = double(outcome.picture.pixels.size());
    const Camera& camera = outcome.camera;
    return {
        {"method", outcome.method},
        {"samples", outcome.samples},
        {"seconds_total", outcome.seconds_total},
        {"seconds_first_image", outcome.seconds_first_image},
        {"seconds_render", outcome.seconds_render},
        {"bytes_streamed", outcome.streamed.bytes_streamed},
        {"pages_streamed", outcome.streamed.pages_streamed},
        {"tree_blocks_streamed", outcome.streamed.blocks_streamed},
        {"round_trips", outcome.streamed.round_trips},
        {"reconnects", outcome.streamed.reconnects},
        {"pages_retried", outcome.retried},
        {"cache_bytes", outcome.cache_bytes},
        {"cache_reloads", outcome.cache.reloads},
        {"light_bytes", outcome.light_bytes},
        {"tree_bytes", outcome.tree_bytes},
        {"passes", outcome.passes},
        {"max_error_bound", boundOrNull(errors.max_bound)},
        {"mean_error_bound", boundOrNull(errors.sum_bound / pixels)},
        {"max_error_estimate", boundOrNull(errors.max_estimate)},
        {"mean_error_estimate", boundOrNull(errors.sum_estimate / pixels)},
        {"max_alpha_error_bound", boundOrNull(errors.max_alpha_bound)},
        {"max_alpha_error_estimate", boundOrNull(errors.max_alpha_estimate)},
        {"mean_alpha", errors.sum_alpha / pixels},
        {"final", outcome.final},
        {"not_final",
         {{"queued", outcome.not_final.queued},
          {"over_budget", outcome.not_final.over_budget},
          {"failed", outcome.not_final.failed},
          {"no_finer_data", outcome.not_final.no_finer_data}}},
        {"first_failure", outcome.first_failure},
        {"width", outcome.picture.width},
        {"height", outcome.picture.height},
        {"camera",
         {{"eye", std::vector<double>(camera.eye().begin(), camera.eye().end())},
          {"target", std::vector<double>(camera.target().begin(), camera.target().end())},
          {"up", std::vector<double>(camera.up().begin(), camera.up().end())},
          {"vertical_fov_degrees", camera.vertical_fov_degrees()}}},
    };
}

}  // namespace

int reportPicture(const RenderOutcome& outcome, const std::filesystem::path& output, bool json) {
    const PictureErrors errors = errorsOf(outcome.picture);
    if (json) {
        fmt::print("{}\n", toJson(outcome, errors).dump());
    } else {
        fmt::print(
            "{}: {} x {}, {}; expected error {:.2g} (largest {:.2g}), {}; {:.2f} s, {} pages, {:.2f} MB\n",
            output.string(), outcome.picture.width, outcome.picture.height,
            outcome.final ? "final" : "not final",
            errors.sum_estimate / double(outcome.picture.pixels.size()), errors.max_estimate,
            std::isfinite(errors.max_bound) ? fmt::format("at most {:.2g}", errors.max_bound)
                                            : std::string("no guarantee"),
            outcome.seconds_total, outcome.streamed.pages_streamed,
            double(outcome.streamed.bytes_streamed) / 1e6);
    }
    std::fflush(stdout);
    if (outcome.not_final.failed > 0)
        return reportError(
            "render", {ErrorCode::kCorrupt,
                       fmt::format("{} pages could not be had and are drawn from coarser ones; first: {}",
                                   outcome.not_final.failed, outcome.first_failure)});
    return kExitDone;
}

}  // namespace brickyard
