#include "tools/scene_window.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "tools/scene_emission.h"

namespace brickyard {

namespace {

struct Classes {
    double threshold = 0, share_above = 0;
};

// Otsu. A threshold selection method from gray-level histograms. 1979.
Classes divide(const SampledField& field, double low, double high) {
    constexpr int kBins = 256;
    std::array<double, kBins> bins{};
    double all = 0, moment = 0;
    for (std::int64_t i = 0; i < field.count(); ++i) {
        const double place = (double(field.value(i)) - low) / (high - low) * kBins;
        const int bin = int(std::clamp(place, 0.0, kBins - 1.0));
        bins[std::size_t(bin)] += 1;
        all += 1;
        moment += bin;
    }
    Classes best{0.5 * (low + high), 0};
    double below = 0, below_moment = 0, most = -1;
    for (int bin = 0; bin + 1 < kBins; ++bin) {
        below += bins[std::size_t(bin)];
        below_moment += bin * bins[std::size_t(bin)];
        if (below == 0 || below == all) continue;
        const double apart = below_moment / below - (moment - below_moment) / (all - below);
        const double between = below * (all - below) * apart * apart;
        if (between <= most) continue;
        most = between;
        best = {low + (bin + 1) * (high - low) / kBins, (all - below) / all};
    }
    return best;
}

}  // namespace

Transfer proposeTransfer(const SampledField& field, double lowest) {
    Transfer transfer;
    transfer.set_shading(0.6);
    // A few bright voxels are a tooth's filling, or noise.
    const double low = field.quantile(0.02), high = field.quantile(0.998);
    if (!(high > low)) {
        transfer.set_preset("grey");
        return transfer;
    }
    // Hounsfield units have air at -1000, and bone from 200 or 300 on.
    if (lowest <= -500) {
        transfer.set_preset("bone");
        transfer.set_level(200);
        transfer.set_width(1000);
        return transfer;
    }
    // What is dense is a small part of a CT; in an MR all that is not air shines.
    const Classes classes = divide(field, low, high);
    const bool bone = classes.share_above < 0.2;
    transfer.set_preset(bone ? "bone" : "skin");
    // Where the preset passes from the one to the other: ivory begins, or the skin.
    const double at = bone ? 0.5 : 0.15;
    const double width = bone ? (classes.threshold - low) / at : (high - classes.threshold) / (1 - at);
    transfer.set_width(rounded(width));
    transfer.set_level(rounded(classes.threshold + (0.5 - at) * width));
    return transfer;
}

}  // namespace brickyard
