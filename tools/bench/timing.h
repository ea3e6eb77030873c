// Seconds of runs that are repeated. Plain values.
#pragma once

#include <algorithm>
#include <chrono>
#include <vector>

namespace brickyard {

class Timing {
public:
    void add(double seconds) {
        seconds_.insert(std::upper_bound(seconds_.begin(), seconds_.end(), seconds), seconds);
    }
    // REQUIRES: something was added.
    double median() const {
        const std::size_t half = seconds_.size() / 2;
        return seconds_.size() % 2 == 1 ? seconds_[half] : 0.5 * (seconds_[half - 1] + seconds_[half]);
    }
    double best() const { return seconds_.front(); }
    bool empty() const { return seconds_.empty(); }

private:
    std::vector<double> seconds_;  // ascending
};

template <class Body>
double secondsOf(const Body& body) {
    const auto begin = std::chrono::steady_clock::now();
    body();
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

}  // namespace brickyard
