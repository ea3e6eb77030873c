// One line on a terminal that is rewritten in place: what is done, how fast, how long it will take. On
// anything but a terminal nothing is printed at all. Not thread-safe.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace brickyard {

class ProgressLine {
public:
    // Writes to stderr where that is a terminal.
    ProgressLine();
    // Clears the line.
    ~ProgressLine();
    ProgressLine(const ProgressLine&) = delete;
    ProgressLine& operator=(const ProgressLine&) = delete;

    // `fraction` of all the work in [0, 1]; `bytes` read or written so far. Draws at most ten times a second.
    void show(const std::string& what, double fraction, std::uint64_t bytes);
    // Makes room for an ordinary line.
    void clear();

private:
    using Clock = std::chrono::steady_clock;
    bool terminal_;
    bool drawn_ = false;
    Clock::time_point started_ = Clock::now();
    Clock::time_point last_{};
};

// "850 ms", "12 s", "3 min 05 s": for people.
std::string describeSeconds(double seconds);
// "512 B", "1.5 MiB".
std::string describeBytes(std::uint64_t bytes);

}  // namespace brickyard
