#include "tools/progress_line.h"

#include <fmt/format.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>

namespace brickyard {

ProgressLine::ProgressLine() : terminal_(::isatty(STDERR_FILENO) == 1) {}

ProgressLine::~ProgressLine() { clear(); }

void ProgressLine::show(const std::string& what, double fraction, std::uint64_t bytes) {
    if (!terminal_) return;
    const auto now = Clock::now();
    if (drawn_ && now - last_ < std::chrono::milliseconds(100)) return;
    last_ = now;
    const double elapsed = std::chrono::duration<double>(now - started_).count();
    std::string line = fmt::format("{}  {:3.0f} %", what, 100 * std::clamp(fraction, 0.0, 1.0));
    if (elapsed > 0.2) line += fmt::format("  {:.1f} MB/s", 1e-6 * double(bytes) / elapsed);
    if (elapsed > 1 && fraction > 0.01)
        line += "  " + describeSeconds(elapsed / fraction - elapsed) + " left";

    // A longer line would wrap, and could not be taken back.
    winsize window{};
    const std::size_t columns =
        ::ioctl(STDERR_FILENO, TIOCGWINSZ, &window) == 0 && window.ws_col > 1 ? window.ws_col : 80;
    if (line.size() >= columns) line.resize(columns - 1);
    fmt::print(stderr, "\r{}\x1b[K", line);
    std::fflush(stderr);
    drawn_ = true;
}

void ProgressLine::clear() {
    if (!drawn_) return;
    fmt::print(stderr, "\r\x1b[K");
    std::fflush(stderr);
    drawn_ = false;
}

std::string describeSeconds(double seconds) {
    if (seconds < 1) return fmt::format("{:.0f} ms", 1000 * std::max(seconds, 0.0));
    if (seconds < 60) return fmt::format("{:.0f} s", seconds);
    const auto whole = std::uint64_t(seconds);
    if (seconds < 3600) return fmt::format("{} min {:02} s", whole / 60, whole % 60);
    return fmt::format("{} h {:02} min", whole / 3600, whole / 60 % 60);
}

std::string describeBytes(std::uint64_t bytes) {
    constexpr const char* kUnits[] = {"B", "KiB", "MiB", "GiB", "TiB", "PiB", "EiB"};
    double value = double(bytes);
    int unit = 0;
    while (value >= 1024) value /= 1024, ++unit;
    return unit == 0 ? fmt::format("{} B", bytes) : fmt::format("{:.1f} {}", value, kUnits[unit]);
}

}  // namespace brickyard
