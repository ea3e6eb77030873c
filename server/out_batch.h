// Messages of the stream in one stretch of memory, each framed as a WebSocket message (RFC 6455, section 5.2:
// a server does not mask), so that many small pages cost one write. Payloads are read from the disk straight
// into their place. One thread at a time.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "server/batch_pool.h"

namespace brickyard {

class OutBatch {
public:
    OutBatch() = default;
    explicit OutBatch(BatchMemory memory) : memory_(std::move(memory)) {}

    explicit operator bool() const { return bool(memory_); }
    bool empty() const { return messages_.empty(); }
    std::size_t size() const { return messages_.empty() ? 0 : messages_.back().end; }
    const std::byte* data() const { return memory_.data(); }

    // What a message of so many bytes takes.
    static std::size_t framedBytes(std::size_t message_bytes);
    bool fits(std::size_t message_bytes) const {
        return size() + framedBytes(message_bytes) <= memory_.capacity();
    }

    // Adds a message and gives the place of its payload, which is to be filled in. A page is one that a newer
    // wish makes useless. REQUIRES: fits(head.size() + payload_bytes).
    std::span<std::byte> add(std::span<const std::byte> head, std::size_t payload_bytes, bool is_page);
    // Takes the last message back.
    void removeLast() { messages_.pop_back(); }

    // Where the message ends that byte `at` lies in; `at` itself where a message begins there. REQUIRES: at
    // <= size().
    std::size_t messageEnd(std::size_t at) const;
    // Removes the pages that begin at byte `from` or behind it. REQUIRES: nothing but pages follows a page.
    void dropPages(std::size_t from);
    // Removes all that begins there or behind it.
    void dropAll(std::size_t from);

    bool endsWithPage() const { return !messages_.empty() && messages_.back().is_page; }
    std::size_t messageCount() const { return messages_.size(); }

private:
    struct Message {
        std::size_t begin = 0, end = 0;
        bool is_page = false;
    };
    BatchMemory memory_;
    std::vector<Message> messages_;
};

}  // namespace brickyard
