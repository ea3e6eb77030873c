#include "tools/importers/vdb_leaf_cache.h"

namespace brickyard {

VdbLeafCache::Leaf VdbLeafCache::find(std::uint32_t field, std::uint32_t leaf) {
    const std::uint64_t key = keyOf(field, leaf);
    Part& part = partOf(key);
    const std::lock_guard lock(part.mutex);
    const auto found = part.index.find(key);
    if (found == part.index.end()) return nullptr;
    part.entries.splice(part.entries.begin(), part.entries, found->second);
    return found->second->bytes;
}

void VdbLeafCache::insert(std::uint32_t field, std::uint32_t leaf, Leaf bytes, std::size_t size) {
    const std::size_t taken = size + kOverheadBytes;
    if (taken > part_budget_bytes_) return;
    const std::uint64_t key = keyOf(field, leaf);
    Part& part = partOf(key);
    // What is dropped is freed after the lock.
    std::list<Entry> dropped;
    const std::lock_guard lock(part.mutex);
    if (part.index.contains(key)) return;  // another thread was faster
    while (part.used_bytes + taken > part_budget_bytes_) {
        part.index.erase(part.entries.back().key);
        part.used_bytes -= part.entries.back().size + kOverheadBytes;
        dropped.splice(dropped.begin(), part.entries, std::prev(part.entries.end()));
    }
    part.entries.push_front({key, std::move(bytes), size});
    part.index.emplace(key, part.entries.begin());
    part.used_bytes += taken;
}

void VdbLeafCache::forget(std::uint32_t field) {
    for (Part& part : parts_) {
        const std::lock_guard lock(part.mutex);
        for (auto entry = part.entries.begin(); entry != part.entries.end();) {
            if (entry->key >> 32 != field) {
                ++entry;
                continue;
            }
            part.used_bytes -= entry->size + kOverheadBytes;
            part.index.erase(entry->key);
            entry = part.entries.erase(entry);
        }
    }
}

std::uint64_t VdbLeafCache::usedBytes() const {
    std::uint64_t used = 0;
    for (const Part& part : parts_) {
        const std::lock_guard lock(part.mutex);
        used += part.used_bytes;
    }
    return used;
}

}  // namespace brickyard
