#include "server/connection_list.h"

namespace brickyard {

std::unique_ptr<ConnectionList::Slot> ConnectionList::take(const boost::asio::ip::address& from) {
    const std::lock_guard lock(mutex_);
    if (slots_.size() >= max_ || closing_) return nullptr;
    if (max_per_address_ != 0) {
        if (const auto has = by_address_.find(from);
            has != by_address_.end() && has->second >= max_per_address_)
            return nullptr;
        ++by_address_[from];
    }
    auto slot = std::make_unique<Slot>(*this, from);
    slots_.insert(slot.get());
    return slot;
}

std::size_t ConnectionList::count() const {
    const std::lock_guard lock(mutex_);
    return slots_.size();
}

void ConnectionList::tellNews() {
    const std::lock_guard lock(mutex_);
    for (Slot* slot : slots_)
        if (slot->news_) slot->news_();
}

void ConnectionList::closeAll() {
    const std::lock_guard lock(mutex_);
    closing_ = true;
    for (Slot* slot : slots_)
        if (slot->close_) slot->close_();
}

bool ConnectionList::waitUntilEmpty(std::chrono::milliseconds patience) {
    std::unique_lock lock(mutex_);
    return emptied_.wait_for(lock, patience, [this] { return slots_.empty(); });
}

void ConnectionList::release(Slot* slot) {
    const std::lock_guard lock(mutex_);
    slots_.erase(slot);
    if (max_per_address_ != 0)
        if (const auto has = by_address_.find(slot->from_); has != by_address_.end() && --has->second == 0)
            by_address_.erase(has);
    // Under the lock: whoever waits may destroy this list as soon as it sees that it is empty.
    if (slots_.empty()) emptied_.notify_all();
}

void ConnectionList::setClose(Slot* slot, std::function<void()> close) {
    const std::lock_guard lock(mutex_);
    slot->close_ = std::move(close);
    if (closing_) slot->close_();
}

void ConnectionList::setNews(Slot* slot, std::function<void()> news) {
    const std::lock_guard lock(mutex_);
    slot->news_ = std::move(news);
}

}  // namespace brickyard
