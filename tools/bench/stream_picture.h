// The picture that a set of resident pages makes, kept up to date page by page, and how far it is from the
// reference. Draws as client/cpu/resident_tree.h says. Not thread-safe.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "tools/bench/stream_table.h"

namespace brickyard {

struct StreamPage {
    std::uint32_t node = 0;  // in StreamTable::nodes
    bool draft = false;
};

class StreamPicture {
public:
    // Nothing resident. `table` must outlive the picture.
    explicit StreamPicture(const StreamTable& table);

    bool has(const StreamPage& page) const {
        return residency_[page.node] == 2 || (page.draft && residency_[page.node] == 1);
    }
    void add(const StreamPage& page);
    // Sum over pixels of the squared error of alpha that the pages together would take off. They must not lie
    // above one another.
    double gainOf(std::span<const StreamPage> pages);
    // The same where the errors of other parts of a ray do not count: they neither hide what the pages repair
    // nor make up for it.
    double ownGainOf(std::span<const StreamPage> pages);

    double squaredError() const { return squared_error_; }
    double psnr() const;
    double worst() const;  // largest error of alpha
    // exp(-optical depth) of each ray, as drawn.
    std::vector<float> transmittance() const;
    // Where each ray falls below `opaque` transmittance; infinity where it does not.
    std::vector<float> opaqueDistance(double opaque) const;

private:
    void collectChange(std::span<const StreamPage> pages);
    template <class Change>
    void forEachChange(const StreamPage& page, bool ancestors, Change change) const;
    double errorOf(std::uint32_t ray, double depth) const;

    const StreamTable& table_;
    std::vector<std::uint8_t> residency_;  // by node: 0 none, 1 draft, 2 whole
    std::vector<std::uint8_t> below_;      // by node: a descendant's page is resident
    std::vector<float> drawn_;             // by stretch
    std::vector<int> rank_;                // by stretch: of what is drawn; lower is finer
    std::vector<double> depth_;            // by ray
    std::vector<float> reference_;         // by ray: alpha
    double squared_error_ = 0;
    // Of the gains: by ray, what would change, and by how much that is off now.
    std::vector<double> change_, off_;
    std::vector<std::uint32_t> changed_;
};

}  // namespace brickyard
