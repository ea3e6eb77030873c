#include "server/io_threads.h"

#include <fmt/chrono.h>

namespace brickyard {

Timed::Timed(IoThread& watcher) : watcher_(watcher) { watcher_.timed_.insert(this); }
Timed::~Timed() { watcher_.timed_.erase(this); }

IoThread::IoThread(std::chrono::milliseconds tick, std::function<void(const std::string&)> on_exception)
    : tick_(tick),
      on_exception_(std::move(on_exception)),
      work_(io_.get_executor()),
      timer_(io_),
      thread_([this] { run(); }) {}

IoThread::~IoThread() { stop(); }

void IoThread::stop() {
    io_.stop();
    if (thread_.joinable()) thread_.join();
}

void IoThread::tellEnd() {
    // Gathered first: each may go when it lets go, and others with it.
    const std::vector<Timed*> all(timed_.begin(), timed_.end());
    for (Timed* timed : all)
        if (timed_.contains(timed)) timed->onThreadEnded();
}

void IoThread::run() {
    this->tick();
    for (;;) {
        // What one connection throws must not end the others.
        try {
            io_.run();
            return;
        } catch (const std::exception& error) {
            on_exception_(error.what());
        }
    }
}

void IoThread::tick() {
    const auto now = Clock::now();
    date_ = fmt::format("{:%a, %d %b %Y %H:%M:%S} GMT", fmt::gmtime(std::time(nullptr)));
    // Gathered first: a session that is told may end, and others with it.
    std::vector<Timed*> late;
    for (Timed* timed : timed_)
        if (timed->deadline_ <= now) late.push_back(timed);
    for (Timed* timed : late)
        if (timed_.contains(timed) && timed->deadline_ <= now) {
            timed->deadline_ = Clock::time_point::max();
            // What one connection throws must not end the ticking for the others.
            try {
                timed->onDeadline();
            } catch (const std::exception& error) {
                on_exception_(error.what());
            }
        }
    timer_.expires_after(tick_);
    timer_.async_wait([this](boost::system::error_code error) {
        if (!error) this->tick();
    });
}

}  // namespace brickyard
