#include "tools/stop_signal.h"

#include <atomic>
#include <csignal>

namespace brickyard {
namespace {

std::atomic<int> received_signal{0};
static_assert(std::atomic<int>::is_always_lock_free, "the handler may do no more than that");

void listen(int signal) {
    struct sigaction action{};
    action.sa_handler = [](int number) { received_signal = number; };
    // No SA_RESTART: whoever sleeps or polls shall look up.
    action.sa_flags = int(SA_RESETHAND);
    ::sigaction(signal, &action, nullptr);
}

}  // namespace

StopSignal::StopSignal() {
    received_signal = 0;
    listen(SIGINT);
    listen(SIGTERM);
}

StopSignal::~StopSignal() {
    std::signal(SIGINT, SIG_DFL);
    std::signal(SIGTERM, SIG_DFL);
}

int StopSignal::received() { return received_signal; }

}  // namespace brickyard
