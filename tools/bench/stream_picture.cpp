#include "tools/bench/stream_picture.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace brickyard {

namespace {

constexpr int kNothingDrawn = std::numeric_limits<int>::max();
constexpr int kExact = -1;

int rankOf(const StreamNode& node, bool draft) { return 2 * node.key.level + (draft ? 1 : 0); }

}  // namespace

StreamPicture::StreamPicture(const StreamTable& table)
    : table_(table),
      residency_(table.nodes().size(), 0),
      below_(table.nodes().size(), 0),
      drawn_(table.stretches().size(), 0.0f),
      rank_(table.stretches().size(), kNothingDrawn),
      depth_(table.rayCount(), 0.0),
      change_(table.rayCount(), 0.0),
      off_(table.rayCount(), 0.0) {
    std::vector<double> depth(table.rayCount(), 0.0);
    for (const StreamStretch& s : table.stretches()) depth[s.ray] += double(table.reference(s));
    for (double d : depth) {
        reference_.push_back(float(-std::expm1(-d)));
        squared_error_ += double(reference_.back()) * double(reference_.back());
    }
}

double StreamPicture::errorOf(std::uint32_t ray, double depth) const {
    const double error = -std::expm1(-depth) - double(reference_[ray]);
    return error * error;
}

// Calls change(stretch, value, rank) for what the page would draw anew.
template <class Change>
void StreamPicture::forEachChange(const StreamPage& page, bool ancestors, Change change) const {
    const StreamNode& node = table_.nodes()[page.node];
    const int rank = rankOf(node, page.draft);
    const std::uint32_t slot = node.depth + (page.draft ? 1 : 0);
    for (std::uint32_t s = node.begin; s < node.end; ++s)
        if (rank_[s] > rank) change(s, table_.value(table_.stretches()[s], slot), rank);
    // Around a page below, topology is exact.
    if (!ancestors) return;
    for (std::uint32_t a = node.parent; a != StreamNode::kNoStreamNode && !below_[a];
         a = table_.nodes()[a].parent)
        for (std::uint32_t s = table_.nodes()[a].begin; s < table_.nodes()[a].own_end; ++s)
            if (rank_[s] != kExact) change(s, table_.stretches()[s].exact, kExact);
}

void StreamPicture::add(const StreamPage& page) {
    if (has(page)) return;
    changed_.clear();
    forEachChange(page, true, [&](std::uint32_t s, float value, int rank) {
        const std::uint32_t ray = table_.stretches()[s].ray;
        if (change_[ray] == 0) changed_.push_back(ray);
        change_[ray] += double(value) - double(drawn_[s]);
        drawn_[s] = value;
        rank_[s] = rank;
    });
    for (std::uint32_t ray : changed_) {
        squared_error_ += errorOf(ray, depth_[ray] + change_[ray]) - errorOf(ray, depth_[ray]);
        depth_[ray] += change_[ray];
        change_[ray] = 0;
    }
    residency_[page.node] = page.draft ? 1 : 2;
    for (std::uint32_t a = table_.nodes()[page.node].parent; a != StreamNode::kNoStreamNode && !below_[a];
         a = table_.nodes()[a].parent)
        below_[a] = 1;
}

void StreamPicture::collectChange(std::span<const StreamPage> pages) {
    changed_.clear();
    bool first = true;
    for (const StreamPage& page : pages) {
        // Siblings share their ancestors.
        forEachChange(page, first, [&](std::uint32_t s, float value, int) {
            const StreamStretch& stretch = table_.stretches()[s];
            if (change_[stretch.ray] == 0 && off_[stretch.ray] == 0) changed_.push_back(stretch.ray);
            change_[stretch.ray] += double(value) - double(drawn_[s]);
            off_[stretch.ray] += double(drawn_[s]) - double(table_.reference(stretch));
        });
        first = false;
    }
}

double StreamPicture::gainOf(std::span<const StreamPage> pages) {
    collectChange(pages);
    double gain = 0;
    for (std::uint32_t ray : changed_) {
        gain += errorOf(ray, depth_[ray]) - errorOf(ray, depth_[ray] + change_[ray]);
        change_[ray] = off_[ray] = 0;
    }
    return gain;
}

double StreamPicture::ownGainOf(std::span<const StreamPage> pages) {
    collectChange(pages);
    double gain = 0;
    for (std::uint32_t ray : changed_) {
        const double seen = 1 - double(reference_[ray]), then = off_[ray] + change_[ray];
        gain += seen * seen * (off_[ray] * off_[ray] - then * then);
        change_[ray] = off_[ray] = 0;
    }
    return gain;
}

double StreamPicture::psnr() const {
    return -10 * std::log10(std::max(squared_error_ / double(table_.rayCount()), 1e-20));
}

double StreamPicture::worst() const {
    double worst = 0;
    for (std::uint32_t ray = 0; ray < depth_.size(); ++ray)
        worst = std::max(worst, errorOf(ray, depth_[ray]));
    return std::sqrt(worst);
}

std::vector<float> StreamPicture::transmittance() const {
    std::vector<float> out(depth_.size());
    std::transform(depth_.begin(), depth_.end(), out.begin(), [](double d) { return float(std::exp(-d)); });
    return out;
}

std::vector<float> StreamPicture::opaqueDistance(double opaque) const {
    std::vector<float> out(depth_.size(), std::numeric_limits<float>::infinity());
    for (std::uint32_t ray = 0; ray < out.size(); ++ray) {
        double depth = 0;
        for (std::uint32_t s : table_.ofRay(ray)) {
            depth += double(drawn_[s]);
            if (depth < -std::log(opaque)) continue;
            out[ray] = float(table_.endOf(s));
            break;
        }
    }
    return out;
}

}  // namespace brickyard
