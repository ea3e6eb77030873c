#include "server/connection_list.h"

namespace brickyard {

std::unique_ptr<ConnectionList::Slot> ConnectionList::take() {
    const std::lock_guard lock(mutex_);
    if (slots_.size() >= max_ || closing_) return nullptr;
    auto slot = std::make_unique<Slot>(*this);
    slots_.insert(slot.get());
    return slot;
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
    // Under the lock: whoever waits may destroy this list as soon as it sees that it is empty.
    if (slots_.empty()) emptied_.notify_all();
}

void ConnectionList::setClose(Slot* slot, std::function<void()> close) {
    const std::lock_guard lock(mutex_);
    slot->close_ = std::move(close);
    if (closing_) slot->close_();
}

}  // namespace brickyard
