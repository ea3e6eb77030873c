#include "tools/importers/slab_cache.h"

#include <cassert>

namespace brickyard {

SlabCache::SlabCache(const DenseFile& file, std::size_t sample_bytes, std::uint64_t budget_bytes)
    : file_(file), sample_bytes_(sample_bytes), budget_bytes_(budget_bytes) {}

std::uint64_t SlabCache::bytesOf(const IndexBox& slab) const {
    return std::uint64_t(slab.extent(0)) * std::uint64_t(slab.extent(1)) * std::uint64_t(slab.extent(2)) *
           sample_bytes_;
}

// Drops slabs that nobody uses, least recently used first, until `bytes` more fit. A buffer that fits is
// passed on to `slab`: fresh pages from the kernel cost as much as filling them.
bool SlabCache::makeRoom(std::uint64_t bytes, Slab& slab) {
    for (;;) {
        if (held_bytes_ + bytes <= budget_bytes_) {
            slab.bytes = std::make_unique_for_overwrite<std::byte[]>(bytes);
            slab.capacity = bytes;
            held_bytes_ += bytes;
            return true;
        }
        auto oldest = slabs_.end();
        for (auto it = slabs_.begin(); it != slabs_.end(); ++it)
            if (it->second->users == 0 &&
                (oldest == slabs_.end() || it->second->last_use < oldest->second->last_use))
                oldest = it;
        if (oldest == slabs_.end()) return false;
        Slab& old = *oldest->second;
        if (old.capacity >= bytes && old.capacity <= 2 * bytes) {
            slab.bytes = std::move(old.bytes);
            slab.capacity = old.capacity;
            slabs_.erase(oldest);
            return true;
        }
        held_bytes_ -= old.capacity;
        slabs_.erase(oldest);
    }
}

SlabCache::Slab* SlabCache::acquire(std::unique_lock<std::mutex>& lock, const IndexBox& box, bool& created) {
    const Key key{box.begin[0], box.begin[1], box.begin[2], box.end[0], box.end[1], box.end[2]};
    for (;;) {
        Slab* found = nullptr;
        if (const auto it = slabs_.find(key); it != slabs_.end()) {
            found = it->second.get();
        } else if (auto fresh = std::make_unique<Slab>(); makeRoom(bytesOf(box), *fresh)) {
            fresh->box = box;
            fresh->pieces = file_.pieceCount(box);
            found = slabs_.emplace(key, std::move(fresh)).first->second.get();
            created = true;
        }
        if (found) {
            ++found->users;
            found->last_use = ++clock_;
            return found;
        }
        // Every slab is being used: by threads that hold one each and wait for none, so this ends.
        changed_.wait(lock);
    }
}

Result<void> SlabCache::with(const IndexBox& box, const IndexBox& announce,
                             const std::function<void(const std::byte*)>& use) {
    assert(bytesOf(box) <= budget_bytes_ / 2);
    bool created = false;
    std::unique_lock lock(mutex_);
    Slab* const slab = acquire(lock, box, created);
    while (slab->next < slab->pieces) {
        const std::size_t piece = slab->next++;
        lock.unlock();
        const auto loaded = file_.loadPiece(box, piece, slab->bytes.get());
        lock.lock();
        if (!loaded && !slab->error) slab->error = loaded.error();
        if (++slab->loaded == slab->pieces) changed_.notify_all();
    }
    changed_.wait(lock, [&] { return slab->loaded == slab->pieces; });

    Result<void> result;
    if (slab->error) {
        result = tl::unexpected(*slab->error);
    } else {
        lock.unlock();
        if (created && !announce.empty()) file_.willNeed(announce);
        use(slab->bytes.get());
        lock.lock();
    }
    --slab->users;
    // The next reader tries again.
    if (slab->error && slab->users == 0) {
        held_bytes_ -= slab->capacity;
        std::erase_if(slabs_, [&](const auto& entry) { return entry.second.get() == slab; });
    }
    changed_.notify_all();
    return result;
}

void SlabCache::clear() {
    const std::lock_guard lock(mutex_);
    slabs_.clear();
    held_bytes_ = 0;
}

}  // namespace brickyard
