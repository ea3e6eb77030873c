// One axis of a chart: where a value stands between the two ends, and which ticks it has. Plain value.
#pragma once

#include <string>
#include <vector>

namespace brickyard {

class PlotAxis {
public:
    struct Tick {
        double value = 0;
        std::string label;  // empty: a short tick without a number
    };

    // `values` are what must fit; those without a place on the axis (not finite, not above 0 on a logarithmic
    // one) are passed over. Without any the axis runs from 0 to 1 (1 to 10).
    PlotAxis(const std::vector<double>& values, bool logarithmic);

    bool shows(double value) const;
    // 0 at the lower end, 1 at the upper. REQUIRES: shows(value).
    double place(double value) const;
    const std::vector<Tick>& ticks() const { return ticks_; }

private:
    void makeLinearTicks();
    void makeLogarithmicTicks();

    bool logarithmic_;
    double low_ = 0, high_ = 1;  // of the value, or of its logarithm to base 10. Invariant: low_ < high_
    std::vector<Tick> ticks_;
};

}  // namespace brickyard
