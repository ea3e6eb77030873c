// `brickyard compare`: how far a picture is from another one, as numbers and as a picture of the difference.

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "client/picture.h"
#include "tools/command.h"

namespace brickyard {

namespace {

// Below this alpha in both pictures a pixel counts as empty.
constexpr float kEmptyAlpha = 1e-3f;

struct CompareOptions {
    std::string picture, reference, difference;
    std::vector<double> background{0, 0, 0};
    std::optional<double> max_rms, max_relative_rms, max_mean;
    std::vector<std::uint32_t> window;  // x, y, width, height; all where empty
    double gain = 10;
    bool json = false;
};

struct Comparison {
    double rms = 0;           // over all pixels and R, G, B
    double rms_covered = 0;   // over the pixels where the picture is not empty
    double relative_rms = 0;  // the latter over the root mean square of the reference there
    double factor = 0;        // that takes the picture to the reference best, in the least squares
    double worst = 0;
    std::uint32_t worst_x = 0, worst_y = 0;
    std::uint64_t covered = 0;
    // Of R, G and B over all pixels, and the largest relative difference of the two.
    std::array<double, 3> mean{}, reference_mean{};
    double mean_difference = 0;
};

std::array<double, 3> over(const Pixel& pixel, const std::vector<double>& background) {
    std::array<double, 3> color{};
    for (std::size_t c = 0; c < 3; ++c)
        color[c] = double(pixel.radiance[c]) + (1 - double(pixel.alpha)) * background[c];
    return color;
}

Comparison comparePictures(const Picture& picture, const Picture& reference,
                           const std::vector<double>& background) {
    Comparison out;
    double sum = 0, covered = 0, squares = 0, products = 0, reference_squares = 0;
    for (std::size_t i = 0; i < picture.pixels.size(); ++i) {
        const auto a = over(picture.pixels[i], background), b = over(reference.pixels[i], background);
        const bool is_covered = picture.pixels[i].alpha > kEmptyAlpha;
        out.covered += is_covered;
        for (std::size_t c = 0; c < 3; ++c) {
            const double difference = a[c] - b[c], square = difference * difference;
            sum += square;
            out.mean[c] += a[c] / double(picture.pixels.size());
            out.reference_mean[c] += b[c] / double(picture.pixels.size());
            // Not a number counts as worst of all, and stays so.
            if (!(std::abs(difference) <= out.worst)) {
                out.worst = std::abs(difference);
                out.worst_x = std::uint32_t(i % picture.width);
                out.worst_y = std::uint32_t(i / picture.width);
            }
            if (!is_covered) continue;
            covered += square;
            squares += a[c] * a[c];
            products += a[c] * b[c];
            reference_squares += b[c] * b[c];
        }
    }
    out.rms = std::sqrt(sum / (3 * double(picture.pixels.size())));
    if (out.covered > 0) out.rms_covered = std::sqrt(covered / (3 * double(out.covered)));
    if (reference_squares > 0) out.relative_rms = std::sqrt(covered / reference_squares);
    if (squares > 0) out.factor = products / squares;
    for (std::size_t c = 0; c < 3; ++c) {
        const double difference = std::abs(out.mean[c] - out.reference_mean[c]) / out.reference_mean[c];
        if (!(difference <= out.mean_difference)) out.mean_difference = difference;
    }
    return out;
}

Picture windowOf(const Picture& picture, const std::vector<std::uint32_t>& window) {
    Picture out(window[2], window[3]);
    for (std::uint32_t y = 0; y < out.height; ++y)
        for (std::uint32_t x = 0; x < out.width; ++x)
            out.pixels[std::size_t(y) * out.width + x] =
                picture.pixels[std::size_t(y + window[1]) * picture.width + x + window[0]];
    return out;
}

// Grey where both agree; brighter where the picture is, darker where the reference is.
Picture differencePicture(const Picture& picture, const Picture& reference,
                          const std::vector<double>& background, double gain) {
    constexpr double kGrey = 0.2;
    Picture out(picture.width, picture.height);
    for (std::size_t i = 0; i < picture.pixels.size(); ++i) {
        const auto a = over(picture.pixels[i], background), b = over(reference.pixels[i], background);
        for (std::size_t c = 0; c < 3; ++c) out.pixels[i].radiance[c] = float(kGrey + gain * (a[c] - b[c]));
        out.pixels[i].alpha = 1;
    }
    return out;
}

Result<Comparison> compareFiles(const CompareOptions& options) {
    const Result<Picture> picture = readExr(options.picture);
    if (!picture) return tl::unexpected(picture.error());
    const Result<Picture> reference = readExr(options.reference);
    if (!reference) return tl::unexpected(reference.error());
    if (picture->width != reference->width || picture->height != reference->height)
        return fail(ErrorCode::kInvalid,
                    fmt::format("{} is {} x {} pixels and {} is {} x {}; give pictures of one size",
                                options.picture, picture->width, picture->height, options.reference,
                                reference->width, reference->height));
    if (!options.difference.empty()) {
        const Result<void> written =
            writePng(differencePicture(*picture, *reference, options.background, options.gain), {},
                     options.difference);
        if (!written) return tl::unexpected(written.error());
    }
    if (options.window.empty()) return comparePictures(*picture, *reference, options.background);
    const auto fits = [](std::uint32_t begin, std::uint32_t length, std::uint32_t all) {
        return length > 0 && begin < all && length <= all - begin;
    };
    const std::vector<std::uint32_t>& window = options.window;
    if (!fits(window[0], window[2], picture->width) || !fits(window[1], window[3], picture->height))
        return fail(ErrorCode::kInvalid,
                    fmt::format("--window {} {} {} {}: give X Y WIDTH HEIGHT within {} x {} pixels",
                                window[0], window[1], window[2], window[3], picture->width, picture->height));
    Comparison found =
        comparePictures(windowOf(*picture, window), windowOf(*reference, window), options.background);
    found.worst_x += window[0];
    found.worst_y += window[1];
    return found;
}

// Empty where the pictures are as near as was asked for.
std::string tooFar(const CompareOptions& options, const Comparison& found) {
    // Written so that a comparison with a NaN is too far.
    if (options.max_rms && !(found.rms_covered <= *options.max_rms))
        return fmt::format("rms {:.3g} is above {:g}", found.rms_covered, *options.max_rms);
    if (options.max_relative_rms && !(found.relative_rms <= *options.max_relative_rms))
        return fmt::format("relative rms {:.3g} is above {:g}", found.relative_rms,
                           *options.max_relative_rms);
    if (options.max_mean && !(found.mean_difference <= *options.max_mean))
        return fmt::format("a channel's mean differs by {:.3g} of the reference's, more than {:g}",
                           found.mean_difference, *options.max_mean);
    return {};
}

int runCompare(const CompareOptions& options) {
    const Result<Comparison> found = compareFiles(options);
    if (!found) return reportError("compare", found.error());
    const std::string why = tooFar(options, *found);
    if (options.json) {
        const nlohmann::json json = {{"rms", found->rms},
                                     {"rms_covered", found->rms_covered},
                                     {"relative_rms", found->relative_rms},
                                     {"factor", found->factor},
                                     {"worst", found->worst},
                                     {"worst_at", {found->worst_x, found->worst_y}},
                                     {"covered_pixels", found->covered},
                                     {"mean", found->mean},
                                     {"reference_mean", found->reference_mean},
                                     {"mean_difference", found->mean_difference},
                                     {"within_limits", why.empty()}};
        fmt::print("{}\n", json.dump());
    } else {
        fmt::print(
            "{}: rms {:.3g} ({:.3g} over all pixels), relative {:.3g}, factor {:.4f}, worst {:.3g} at ({}, "
            "{}); means R {:.4g}, G {:.4g}, B {:.4g}, off by at most {:.3g}\n",
            options.picture, found->rms_covered, found->rms, found->relative_rms, found->factor, found->worst,
            found->worst_x, found->worst_y, found->mean[0], found->mean[1], found->mean[2],
            found->mean_difference);
    }
    if (why.empty()) return kExitDone;
    return reportError("compare", {ErrorCode::kInvalid, fmt::format("{} against {}: {}", options.picture,
                                                                    options.reference, why)});
}

}  // namespace

void addCompareCommand(CLI::App& app, int& status) {
    auto options = std::make_shared<CompareOptions>();
    CLI::App* command = app.add_subcommand("compare", "Hold a picture against a reference");
    command->add_option("PICTURE", options->picture, "An .exr file")->required();
    command->add_option("REFERENCE", options->reference, "An .exr file of the same size")->required();
    command
        ->add_option("--background", options->background,
                     "R G B, linear: both pictures are composed over it first")
        ->expected(3)
        ->capture_default_str();
    command->add_option("--max-rms", options->max_rms,
                        "Fail above this root mean square of the difference where the picture is not empty");
    command->add_option("--max-relative-rms", options->max_relative_rms,
                        "The same, relative to the reference's root mean square there");
    command->add_option(
        "--max-mean", options->max_mean,
        "Fail where the mean of R, G or B differs by more than this share of the reference's");
    command->add_option("--window", options->window, "X Y WIDTH HEIGHT: compare these pixels alone")
        ->expected(4);
    command->add_option("--difference", options->difference,
                        "OUT.png: grey where they agree, brighter where PICTURE is");
    command->add_option("--gain", options->gain, "Of the difference picture")->capture_default_str();
    command->add_flag("--json", options->json, "One JSON object on stdout and nothing else");
    command->callback([options, &status] { status = runCompare(*options); });
}

}  // namespace brickyard
