#include "tools/bench/scratch_folder.h"

#include <pthread.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <ctime>

#include "core/io_error.h"

namespace brickyard {
namespace {

sigset_t endingSignals() {
    sigset_t set;
    sigemptyset(&set);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) sigaddset(&set, signal);
    return set;
}

// As if nobody had caught it: the shell sees how the program ended.
void endBy(int signal) {
    std::signal(signal, SIG_DFL);
    const sigset_t set = endingSignals();
    ::pthread_sigmask(SIG_UNBLOCK, &set, nullptr);
    ::raise(signal);
}

}  // namespace

Result<std::unique_ptr<ScratchFolder>> ScratchFolder::create() {
    std::error_code error;
    std::filesystem::path parent = std::filesystem::temp_directory_path(error);
    if (error) parent = "/tmp";
    std::string pattern = (parent / "brickyard-bench-XXXXXX").string();
    if (!::mkdtemp(pattern.data())) return ioError("create a folder in", parent, errno);
    return std::unique_ptr<ScratchFolder>(new ScratchFolder(pattern));
}

ScratchFolder::ScratchFolder(std::filesystem::path path) : path_(std::move(path)) {
    const sigset_t set = endingSignals();
    ::pthread_sigmask(SIG_BLOCK, &set, nullptr);
    // A handler could remove nothing: that takes memory and locks.
    watch_ = std::jthread([this, set](const std::stop_token& stop) {
        constexpr timespec kPause{0, 100'000'000};
        while (!stop.stop_requested()) {
            const int signal = ::sigtimedwait(&set, nullptr, &kPause);
            if (signal <= 0) continue;
            remove();
            endBy(signal);
        }
    });
}

ScratchFolder::~ScratchFolder() {
    watch_.request_stop();
    watch_.join();
    remove();
    const sigset_t set = endingSignals();
    ::pthread_sigmask(SIG_UNBLOCK, &set, nullptr);
}

void ScratchFolder::remove() const {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
}

}  // namespace brickyard
