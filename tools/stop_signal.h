// A wish to stop, from the keyboard (SIGINT) or from the system (SIGTERM): noted, and asked for between
// bricks. The second one of a kind ends the program at once, as it would without us.
#pragma once

namespace brickyard {

class StopSignal {
public:
    // Listens until its end. One at a time.
    StopSignal();
    ~StopSignal();
    StopSignal(const StopSignal&) = delete;
    StopSignal& operator=(const StopSignal&) = delete;

    // The signal's number, or 0. Any thread.
    static int received();
};

}  // namespace brickyard
