// The threads that serve connections, each with an event loop of its own: a connection stays on one of them,
// so its handlers need no locks, and never wait for a disk. Any thread but where it says otherwise.
#pragma once

#include <atomic>
#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <boost/asio/steady_timer.hpp>
#include <chrono>
#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <unordered_set>
#include <vector>

namespace brickyard {

using Clock = std::chrono::steady_clock;

class IoThread;

// What must have happened by some time. Lives and dies on the thread that watches it.
class Timed {
public:
    explicit Timed(IoThread& watcher);
    virtual ~Timed();
    Timed(const Timed&) = delete;
    Timed& operator=(const Timed&) = delete;

protected:
    void expireAfter(std::chrono::milliseconds patience) { deadline_ = Clock::now() + patience; }
    void expireAt(Clock::time_point when) { deadline_ = when; }
    void expireNever() { deadline_ = Clock::time_point::max(); }
    // On the thread, once for each deadline that passed; up to a tick late.
    virtual void onDeadline() = 0;
    // The thread has ended, and what it was to do is never done: who is held by something of its own must let
    // go of it. Perhaps on another thread.
    virtual void onThreadEnded() {}

private:
    friend class IoThread;
    IoThread& watcher_;
    Clock::time_point deadline_ = Clock::time_point::max();
};

// A timer for each of ten thousand connections would cost more than looking at all of them now and then.
class IoThread {
public:
    IoThread(std::chrono::milliseconds tick, std::function<void(const std::string&)> on_exception);
    ~IoThread();
    boost::asio::io_context& io() { return io_; }
    // On the thread: the time of day as HTTP wants it, at most a tick old.
    const std::string& date() const { return date_; }
    // Handlers that have not run yet never will; sessions end with their last handler.
    void stop();
    // Tells those it watches that it has ended. REQUIRES: stopped, and nobody else uses them.
    void tellEnd();

private:
    friend class Timed;
    void run();
    void tick();

    const std::chrono::milliseconds tick_;
    const std::function<void(const std::string&)> on_exception_;
    std::unordered_set<Timed*> timed_;  // outlives `io_`, whose handlers hold sessions
    std::string date_;
    boost::asio::io_context io_{1};
    boost::asio::executor_work_guard<boost::asio::io_context::executor_type> work_;
    boost::asio::steady_timer timer_;
    std::thread thread_;
};

}  // namespace brickyard
