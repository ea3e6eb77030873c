// The connections that are open: how many there may be, and how to reach them all. Any thread.
#pragma once

#include <boost/asio/ip/address.hpp>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <unordered_set>

namespace brickyard {

class ConnectionList {
public:
    // One connection's place; whoever serves the connection holds it, and frees it by letting go.
    class Slot {
    public:
        Slot(ConnectionList& list, boost::asio::ip::address from) : list_(list), from_(std::move(from)) {}
        ~Slot() { list_.release(this); }
        Slot(const Slot&) = delete;
        Slot& operator=(const Slot&) = delete;
        // What ends this connection, and what tells it that the catalog or the tokens changed; from any
        // thread and perhaps at once: must only post, not act.
        void onClose(std::function<void()> close) { list_.setClose(this, std::move(close)); }
        void onNews(std::function<void()> news) { list_.setNews(this, std::move(news)); }

    private:
        friend class ConnectionList;
        ConnectionList& list_;
        const boost::asio::ip::address from_;
        std::function<void()> close_, news_;  // guarded by list_.mutex_
    };

    // `max_per_address` 0: no limit but `max`.
    ConnectionList(std::size_t max, std::size_t max_per_address)
        : max_(max), max_per_address_(max_per_address) {}

    // nullptr where all places are taken, or all of this address.
    std::unique_ptr<Slot> take(const boost::asio::ip::address& from);
    std::size_t count() const;
    // Tells every connection that there is news.
    void tellNews();
    // Ends every connection, and each that comes later.
    void closeAll();
    // Whether all were gone in time.
    bool waitUntilEmpty(std::chrono::milliseconds patience);

private:
    void release(Slot* slot);
    void setClose(Slot* slot, std::function<void()> close);
    void setNews(Slot* slot, std::function<void()> news);

    const std::size_t max_, max_per_address_;
    mutable std::mutex mutex_;
    std::condition_variable emptied_;
    bool closing_ = false;
    std::unordered_set<Slot*> slots_;
    std::map<boost::asio::ip::address, std::size_t> by_address_;  // only where that is limited
};

}  // namespace brickyard
