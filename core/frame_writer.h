// Writes one frame file front to back: payloads, tree blocks, footer. Sequential, so it works on anything
// that can be appended to. docs/format.md tells the order. Not thread-safe.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>

#include "core/result.h"
#include "proto/dataset.pb.h"

namespace brickyard {

struct StoredBytes {
    std::uint64_t offset = 0;
    std::uint32_t bytes = 0;
    std::uint64_t checksum = 0;
};

class FrameWriter {
public:
    // Truncates `file`. Errors: kIo.
    static Result<std::unique_ptr<FrameWriter>> create(const std::filesystem::path& file);
    ~FrameWriter();

    // Appends; tells where it lies. Errors: kIo (a full disk says so).
    Result<StoredBytes> append(std::span<const std::byte> bytes);
    std::uint64_t position() const { return position_; }

    // Writes the footer and the trailer, syncs, closes. Gives the file's size and the footer's checksum.
    struct Finished {
        std::uint64_t file_bytes = 0;
        std::uint64_t footer_checksum = 0;
    };
    Result<Finished> finish(const FrameFooter& footer);

private:
    FrameWriter() = default;
    Result<void> flush();
    std::filesystem::path path_;
    int descriptor_ = -1;
    std::uint64_t position_ = 0;
    std::vector<std::byte> buffer_;
};

}  // namespace brickyard
