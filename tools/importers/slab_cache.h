// The slabs of a dense file that are in memory: shared by all threads, bounded in bytes. Several threads that
// want the same slab load it together.
#pragma once

#include <array>
#include <condition_variable>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>

#include "core/index_box.h"
#include "tools/importers/dense_file.h"

namespace brickyard {

class SlabCache {
public:
    // Never holds more than `budget_bytes`. `sample_bytes`: all components of a sample. `file` outlives the
    // cache.
    SlabCache(const DenseFile& file, std::size_t sample_bytes, std::uint64_t budget_bytes);

    std::uint64_t budgetBytes() const { return budget_bytes_; }
    std::uint64_t bytesOf(const IndexBox& slab) const;

    // Calls `use` with the slab's elements, loaded if need be; they are there for as long as the call lasts.
    // `announce`, where it is not empty, is what will be wanted next. REQUIRES: bytesOf(slab) within half the
    // budget, and no second call from inside `use`. Errors: those of the file.
    Result<void> with(const IndexBox& slab, const IndexBox& announce,
                      const std::function<void(const std::byte*)>& use);
    // Lets go of every slab. Not while another thread reads.
    void clear();

private:
    struct Slab {
        IndexBox box;
        std::unique_ptr<std::byte[]> bytes;
        std::uint64_t capacity = 0;
        std::size_t pieces = 0, next = 0, loaded = 0;
        std::optional<Error> error;
        int users = 0;
        std::uint64_t last_use = 0;
    };
    using Key = std::array<std::int64_t, 6>;

    Slab* acquire(std::unique_lock<std::mutex>& lock, const IndexBox& box, bool& created);
    bool makeRoom(std::uint64_t bytes, Slab& slab);

    const DenseFile& file_;
    std::size_t sample_bytes_;
    std::uint64_t budget_bytes_;
    std::mutex mutex_;
    std::condition_variable changed_;  // a slab was loaded, or is used no longer
    std::map<Key, std::unique_ptr<Slab>> slabs_;
    std::uint64_t held_bytes_ = 0;  // Invariant: the sum of the capacities; at most budget_bytes_
    std::uint64_t clock_ = 0;
};

}  // namespace brickyard
