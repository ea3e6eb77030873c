// A page within one frame: a brick, by the place of its node in the octree, whole or its draft. Plain value,
// any thread.
#pragma once

#include <cstddef>
#include <cstdint>

namespace brickyard {

struct PageAddress {
    std::uint32_t channel = 0;  // index in FrameFooter.channels
    std::uint32_t block = 0;    // index in ChannelFooter.blocks
    std::uint32_t node = 0;     // index in the block
    bool draft =
        false;  // only the prefix of the payload that decodes to an approximation (core/brick_codec.h)

    bool operator==(const PageAddress&) const = default;
};

struct PageAddressHash {
    std::size_t operator()(const PageAddress& a) const {
        std::uint64_t h = (std::uint64_t(a.block) << 32 | a.node) ^ (std::uint64_t(a.channel) << 48) ^
                          (std::uint64_t(a.draft) << 47);
        h = (h ^ (h >> 30)) * 0xbf58476d1ce4e5b9ull;
        h = (h ^ (h >> 27)) * 0x94d049bb133111ebull;
        return std::size_t(h ^ (h >> 31));
    }
};

}  // namespace brickyard
