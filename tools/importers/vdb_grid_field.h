// One grid of a .vdb file as a field that reads from the file what it is asked for. In memory are the
// topology (vdb_tree.h), from the first question on until release(), and a bounded number of decoded leaves,
// which all fields of a file share.
#pragma once

#include <atomic>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "core/field_source.h"
#include "tools/importers/vdb_bytes.h"
#include "tools/importers/vdb_leaf_cache.h"
#include "tools/importers/vdb_tree.h"

namespace brickyard {

// Where a grid's tree is and how to read it.
struct VdbTreePlace {
    std::uint64_t begin = 0, end = 0;
    VdbCoding coding;   // the background is read from the tree
    std::string where;  // "a.vdb: grid 'density'", for messages
};

class VdbGridField final : public FieldSource {
public:
    // `info` has everything but the active voxels and their box; `number` is the field's own in `cache`.
    VdbGridField(std::shared_ptr<const VdbBytes> file, VdbTreePlace place, ChannelInfo info,
                 std::shared_ptr<VdbLeafCache> cache, std::uint32_t number);

    // Active voxels and box are zero until the first uniformOver() or read() has returned.
    const ChannelInfo& info() const override { return *current_info_.load(std::memory_order_acquire); }

    // The first call passes over the grid's bytes. Where that fails, read() has the error, always; here no
    // more is known than that, told for boxes around the origin alone, so that whoever descends where nothing
    // is known comes to a read().
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override;
    Result<void> read(const IndexBox& box, SampleBlock& out) const override;
    void release() const override;

private:
    struct Window;
    struct Buffers;

    Result<const VdbTree*> tree() const;
    Result<void> fill(const VdbTree& tree, const IndexBox& box, SampleBlock& out) const;
    Result<void> copyLeaves(const VdbTree& tree, std::span<const std::pair<IndexBox, VdbLeafPlace>> leaves,
                            const Window& window, Buffers& buffers) const;
    Result<VdbLeafCache::Leaf> decode(const VdbTree& tree, const VdbLeafPlace& place,
                                      std::span<const std::byte> record, Buffers& buffers) const;
    std::size_t leafBytes() const;

    const std::shared_ptr<const VdbBytes> file_;
    const VdbTreePlace place_;
    const ChannelInfo first_info_;  // as before the tree is known
    const std::shared_ptr<VdbLeafCache> cache_;
    const std::uint32_t number_;

    mutable std::mutex mutex_;  // of what follows, but for reading the two pointers
    mutable std::unique_ptr<const VdbTree> tree_;
    mutable std::unique_ptr<const ChannelInfo> full_info_;
    mutable std::optional<Error> error_;
    mutable std::atomic<const VdbTree*> current_tree_{nullptr};
    mutable std::atomic<const ChannelInfo*> current_info_;
};

}  // namespace brickyard
