// One frame file, open for reading: footer, tree blocks and payloads. Payloads come back as stored: checked,
// not decoded. Layout: docs/format.md. Immutable once open, so any thread may call any const member.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <vector>

#include "core/node_key.h"
#include "core/result.h"
#include "core/tree_block.h"
#include "proto/dataset.pb.h"

namespace brickyard {

// A stretch of a frame file.
struct ByteRange {
    std::uint64_t begin = 0;
    std::uint64_t end = 0;
};

// Whether a read may wait for the disk. A read that may not gives kWouldBlock where the bytes are not in the
// page cache of the operating system; partial results are thrown away.
enum class ReadMode { kMayBlock, kCachedOnly };

class BrickStore {
public:
    // Costs one ranged read of the tail, a second one where the footer is larger than that. Errors:
    // kNotFound; kTooNew (the file's major version is above ours); kCorrupt (magic, lengths or checksum do
    // not hold); kIo.
    static Result<std::shared_ptr<const BrickStore>> open(const std::filesystem::path& file);
    ~BrickStore();
    BrickStore(const BrickStore&) = delete;
    BrickStore& operator=(const BrickStore&) = delete;

    const FrameFooter& footer() const { return footer_; }
    std::uint64_t footerChecksum() const { return footer_checksum_; }
    std::uint64_t fileBytes() const { return file_bytes_; }
    const std::filesystem::path& path() const { return path_; }
    // Open for the life of the store; for sendfile and pread.
    int descriptor() const { return descriptor_; }

    // Stored bytes of a tree block, checksum verified. Errors: kNotFound (no such channel or block);
    // kCorrupt; kIo.
    Result<std::vector<std::byte>> readBlock(std::uint32_t channel, std::uint32_t block) const;
    // The same, decoded.
    Result<TreeBlock> loadBlock(std::uint32_t channel, std::uint32_t block) const;
    // Stored bytes of a node's payload, checksum verified. `where` names the node in messages, e.g. "density
    // L0(1,2,3)". REQUIRES: record.hasBrick(). Errors: kCorrupt (names file and node); kIo.
    Result<std::vector<std::byte>> readPayload(const NodeRecord& record, const std::string& where) const;
    // The same bytes, not verified: a server forwards them, and the client checks. Errors: kIo; kCorrupt
    // (outside the file).
    Result<std::vector<std::byte>> readPayloadUnchecked(const NodeRecord& record) const;
    // The first out.size() bytes of it, into memory of the caller's. REQUIRES: out.size() <=
    // record.payload_bytes. Errors: those above; kWouldBlock.
    Result<void> readPayloadInto(const NodeRecord& record, std::span<std::byte> out, ReadMode mode) const;
    // A stored tree block, not verified. REQUIRES: the footer has the block, and out.size() is its size.
    // Errors: kIo, kCorrupt, kWouldBlock.
    Result<void> readBlockInto(std::uint32_t channel, std::uint32_t block, std::span<std::byte> out,
                               ReadMode mode) const;

private:
    BrickStore() = default;
    Result<void> readAt(std::uint64_t offset, std::byte* out, std::size_t bytes,
                        ReadMode mode = ReadMode::kMayBlock) const;
    Result<void> checkPayloadRange(const NodeRecord& record) const;

    std::filesystem::path path_;
    int descriptor_ = -1;
    std::uint64_t file_bytes_ = 0;  // measured at open. Invariant: every range handed out ends at or below it
    std::uint64_t footer_checksum_ = 0;
    FrameFooter footer_;
};

// XXH64 with seed 0: the checksum of every payload, block and footer.
std::uint64_t checksum(std::span<const std::byte> bytes);

}  // namespace brickyard
