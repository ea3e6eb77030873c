// Decoded leaves of one .vdb file, least recently used out first: neighbouring boxes share the leaves at
// their faces. Any thread; it is divided so that threads seldom wait for each other.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <list>
#include <memory>
#include <mutex>
#include <unordered_map>

namespace brickyard {

class VdbLeafCache {
public:
    using Leaf = std::shared_ptr<const std::byte[]>;

    explicit VdbLeafCache(std::uint64_t budget_bytes) : part_budget_bytes_(budget_bytes / kParts) {}

    // nullptr where it is not there.
    Leaf find(std::uint32_t field, std::uint32_t leaf);
    void insert(std::uint32_t field, std::uint32_t leaf, Leaf bytes, std::size_t size);
    // Drops the leaves of one field.
    void forget(std::uint32_t field);
    // What is held, with what it takes to find it.
    std::uint64_t usedBytes() const;

private:
    static constexpr std::size_t kParts = 16;
    // List and table nodes, the counts of the shared pointer and the allocator's own.
    static constexpr std::size_t kOverheadBytes = 160;

    struct Entry {
        std::uint64_t key;
        Leaf bytes;
        std::size_t size;
    };
    struct Part {
        mutable std::mutex mutex;
        std::uint64_t used_bytes = 0;  // Invariant: the sum of sizes and overheads, at most the part's budget
        std::list<Entry> entries;      // most recently used first
        std::unordered_map<std::uint64_t, std::list<Entry>::iterator> index;
    };
    static std::uint64_t keyOf(std::uint32_t field, std::uint32_t leaf) {
        return std::uint64_t(field) << 32 | leaf;
    }
    Part& partOf(std::uint64_t key) { return parts_[(key * 0x9e3779b97f4a7c15u) >> 60]; }

    const std::uint64_t part_budget_bytes_;
    std::array<Part, kParts> parts_;
};

}  // namespace brickyard
