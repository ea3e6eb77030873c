// A dataset that a test knows by heart: full octrees whose payloads are bytes that name themselves. Nothing
// on the way of a page decodes it, so the bytes need not be bricks.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "core/brick_store.h"
#include "core/page_address.h"

namespace brickyard {

struct TinyOptions {
    std::vector<std::uint32_t> frames{30};
    std::vector<std::string> channels{"density", "heat"};
    int levels = 3;                    // the root's level + 1; 5 levels make several tree blocks
    std::uint32_t payload_bytes = 96;  // of every node; at least 16
};

// The root of each channel is L(levels - 1)(0,0,0) with bricks of 8 cells and the identity as transform; all
// octants exist down to level 0, but octant 7 of the root, which is a leaf of one value. A node of level l
// has bound 2^l.
class TinyDataset {
public:
    // A fresh folder below the system's temporary folder; `name` is the dataset's.
    explicit TinyDataset(const std::string& name = "tiny", const TinyOptions& options = {});
    ~TinyDataset();
    TinyDataset(const TinyDataset&) = delete;
    TinyDataset& operator=(const TinyDataset&) = delete;

    const std::filesystem::path& folder() const { return folder_; }
    // Every brick of a channel of the first frame, in the order of blocks and nodes; the root is the first.
    std::vector<PageAddress> bricks(std::uint32_t channel) const;
    // The stored bytes of a brick of the first frame.
    std::vector<std::byte> payload(const PageAddress& brick) const;
    std::uint32_t blockCount(std::uint32_t channel) const;
    // The first frame, opened anew.
    std::shared_ptr<const BrickStore> store() const;

private:
    std::filesystem::path scratch_, folder_;
    std::uint32_t first_frame_ = 0;
};

}  // namespace brickyard
