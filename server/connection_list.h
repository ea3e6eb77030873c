// The connections that are open: how many there may be, and how to end them all. Any thread.
#pragma once

#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <unordered_set>

namespace brickyard {

class ConnectionList {
public:
    // One connection's place; whoever serves the connection holds it, and frees it by letting go.
    class Slot {
    public:
        explicit Slot(ConnectionList& list) : list_(list) {}
        ~Slot() { list_.release(this); }
        Slot(const Slot&) = delete;
        Slot& operator=(const Slot&) = delete;
        // What ends this connection, from any thread and perhaps at once: must only post, not act.
        void onClose(std::function<void()> close) { list_.setClose(this, std::move(close)); }

    private:
        friend class ConnectionList;
        ConnectionList& list_;
        std::function<void()> close_;  // guarded by list_.mutex_
    };

    explicit ConnectionList(std::size_t max) : max_(max) {}

    // nullptr where all places are taken.
    std::unique_ptr<Slot> take();
    // Ends every connection, and each that comes later.
    void closeAll();
    // Whether all were gone in time.
    bool waitUntilEmpty(std::chrono::milliseconds patience);

private:
    void release(Slot* slot);
    void setClose(Slot* slot, std::function<void()> close);

    const std::size_t max_;
    std::mutex mutex_;
    std::condition_variable emptied_;
    bool closing_ = false;
    std::unordered_set<Slot*> slots_;
};

}  // namespace brickyard
