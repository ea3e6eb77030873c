#include "tools/bench/lit_comparison.h"

#include <fmt/format.h>

#include <glm/geometric.hpp>
#include <numbers>

#include "tools/bench/contender.h"
#include "tools/bench/text_table.h"
#include "tools/bench/vdb_render_process.h"

namespace brickyard {
namespace {

constexpr double kAlbedo = 0.8;
// The double integral is worked out for so many pixels a side: a shadow ray from each of four points in each
// cell of each ray would take minutes for all of them.
constexpr std::uint32_t kTruthEdge = 48;

struct LitScene {
    glm::dvec3 to_light;
    std::uint32_t stride;      // between pixels that have a truth
    std::vector<float> truth;  // radiance of those
};

// From above, the side and the front, so that the shadows are seen.
glm::dvec3 lightOf(const PinholeCamera& camera) {
    return glm::normalize(0.85 * camera.up() + 0.4 * camera.right() - 0.3 * camera.forward());
}

// With this irradiance albedo and phase function multiply to 1, and a picture's radiance is the truth's
// integral.
double irradiance() { return 4 * std::numbers::pi / kAlbedo; }

RenderRequest litRequest(const BenchSubject& subject, const BenchView& view, std::uint32_t size,
                         const QualitySettings& quality, const LitScene& lit) {
    RenderRequest request = requestOf(subject, view, size, quality);
    for (int c = 0; c < 3; ++c) request.scene.mutable_medium()->add_albedo(float(kAlbedo));
    Light& light = *request.scene.add_lights();
    for (int a = 0; a < 3; ++a) {
        light.add_direction(-lit.to_light[a]);
        light.add_irradiance(float(irradiance()));
    }
    return request;
}

// The figures of the pixels that have a truth, where `of(i)` is that of pixel i.
template <class Of>
auto atTruth(const LitScene& lit, std::uint32_t size, const Of& of) {
    std::vector<decltype(of(0))> values;
    const std::uint32_t edge = size / lit.stride, first = lit.stride / 2;
    for (std::uint32_t y = 0; y < edge; ++y)
        for (std::uint32_t x = 0; x < edge; ++x)
            values.push_back(of(std::size_t(y * lit.stride + first) * size + x * lit.stride + first));
    return values;
}

Contender ourContender(const std::string& name, const BenchSubject& subject, RenderRequest request,
                       const LitScene& lit) {
    request.repeats = 1;
    Contender contender;
    contender.name = name;
    contender.ours = true;
    contender.draw = [&subject, &lit, request](PictureError* error) -> Result<double> {
        const Result<RenderOutcome> outcome = renderDataset(subject.dataset, request);
        if (!outcome) return tl::unexpected(outcome.error());
        const auto claim = [&](std::size_t i) {
            const Pixel& pixel = outcome->picture.pixels[i];
            return Claim{pixel.radiance[0], pixel.estimate_radiance, pixel.bound_radiance};
        };
        if (error) error->addClaims(atTruth(lit, request.width, claim), lit.truth);
        return outcome->seconds_render;
    };
    return contender;
}

Contender vdbRenderContender(const std::filesystem::path& program, const VdbRenderJob& job,
                             const LitScene& lit, const std::filesystem::path& scratch) {
    Contender contender;
    contender.name = "vdb_render";
    contender.draw = [program, job, &lit, scratch](PictureError* error) -> Result<double> {
        const Result<VdbRenderPicture> picture = runVdbRender(program, job, scratch);
        if (!picture) return tl::unexpected(picture.error());
        const auto red = [&](std::size_t i) { return picture->radiance[i]; };
        if (error) error->addValues(atTruth(lit, job.size, red), lit.truth);
        return picture->seconds;
    };
    return contender;
}

VdbRenderJob jobOf(const BenchSubject& subject, const BenchView& view, std::uint32_t size,
                   const LitScene& lit) {
    VdbRenderJob job;
    job.file = subject.cache.file;
    job.grid = subject.cache.channel;
    job.camera = view.camera;
    job.size = size;
    job.extinction = subject.density_scale * subject.transform.voxelSize();
    job.albedo = kAlbedo;
    job.to_light = lit.to_light;
    job.light = 1 / kAlbedo;
    return job;
}

nlohmann::json report(const std::vector<Contender>& contenders, bool with_peer, const BenchOptions& options) {
    const double size = double(options.size);
    std::uint64_t broken = 0;
    TextTable table({"lit", "seconds", "Mrays/s", "rms", "worst"});
    nlohmann::json json{{"pictures", nlohmann::json::array()}};
    for (const Contender& contender : contenders) {
        const double rate = size * size / contender.timing.median() / 1e6;
        table.add({contender.name, cell(contender.timing.median()), cell(rate), cell(contender.error.rms()),
                   cell(contender.error.worst())});
        json["pictures"].push_back({{"name", contender.name},
                                    {"seconds", contender.timing.median()},
                                    {"seconds_best", contender.timing.best()},
                                    {"mrays_per_second", rate},
                                    {"rms", contender.error.rms()},
                                    {"worst", contender.error.worst()}});
        if (!contender.ours) continue;
        json["pictures"].back()["error"] = toJson(contender.error);
        broken += contender.error.broken();
    }
    options.print(table.text());
    if (broken > 0) options.print(fmt::format("  {} pixels break their bound", broken));
    if (!with_peer) return json;

    const Contender& peer = contenders.back();
    const double reference = peer.timing.median() / contenders.front().timing.median();
    json["vdb_render_over_reference"] = reference;
    std::string text = fmt::format("  vdb_render takes {} times as long as our reference", cell(reference));
    if (const Contender* ours = cheapestOfOurs(contenders, peer.error.rms())) {
        const double equal = peer.timing.median() / ours->timing.median();
        json["vdb_render_over_ours_at_equal_rms"] = equal;
        json["ours_at_equal_rms"] = ours->name;
        text +=
            fmt::format(", {} times as long as `{}`, which is at least as exact", cell(equal), ours->name);
    }
    options.print(text);
    return json;
}

}  // namespace

Result<nlohmann::json> compareLit(const BenchSubject& subject, const BenchView& view,
                                  const BenchOptions& all_options, WorkerPool& pool) {
    // A shadow ray from every sample: a quarter of the pixels keeps the whole at minutes.
    BenchOptions options = all_options;
    options.size = std::max(options.size / 2, 1u);
    const Result<PinholeCamera> camera = PinholeCamera::create(view.camera, options.size, options.size);
    if (!camera) return tl::unexpected(camera.error());
    LitScene lit{lightOf(*camera), std::max(options.size / kTruthEdge, 1u), {}};
    for (const double radiance :
         subject.walk.scattered(*camera, subject.density_scale, lit.to_light, lit.stride, pool.parallelFor()))
        lit.truth.push_back(float(radiance));

    std::vector<Contender> contenders;
    const auto add = [&](const std::string& name, const QualitySettings& quality) {
        contenders.push_back(
            ourContender(name, subject, litRequest(subject, view, options.size, quality, lit), lit));
    };
    add("reference", {.reference = true});
    for (const double error : {0.01, 0.03, 0.1})
        add(fmt::format("max-error {}", error), {.max_error = error});

    std::string skipped;
    if (const auto program = findVdbRender()) {
        contenders.push_back(
            vdbRenderContender(*program, jobOf(subject, view, options.size, lit), lit, options.scratch));
        // A program that cannot draw this cache is no failure of ours.
        if (const Result<double> tried = contenders.back().draw(nullptr); !tried) {
            skipped = tried.error().message;
            contenders.pop_back();
        }
    } else {
        skipped = "vdb_render is not installed (package libopenvdb-tools)";
    }
    if (Result<void> done = race(contenders, options.repeats); !done) return tl::unexpected(done.error());
    nlohmann::json json = report(contenders, skipped.empty(), options);
    json["to_light"] = {lit.to_light.x, lit.to_light.y, lit.to_light.z};
    json["size"] = options.size;
    json["truth_pixels"] = lit.truth.size();
    if (skipped.empty()) return json;
    json["skipped"] = skipped;
    options.print("  vdb_render is left out: " + skipped);
    return json;
}

}  // namespace brickyard
