// Time on the clock that does not go back. Any thread.
#pragma once

#include <chrono>

namespace brickyard {

inline double secondsSince(std::chrono::steady_clock::time_point begin) {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

}  // namespace brickyard
