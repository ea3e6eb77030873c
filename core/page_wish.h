// What a client asks for: pages by address, or whatever a camera sees. Plain values, shared by the source on
// the client's side and by whoever answers.
#pragma once

#include <cstdint>
#include <vector>

#include "core/page_address.h"
#include "proto/scene.pb.h"

namespace brickyard {

// A tree block (`node` unused) or a brick.
struct WishedPage {
    bool is_block = false;
    PageAddress address;
};

// What a cold client sends instead of a list: the source finds the pages. Channels are indices in the footer.
struct CameraView {
    Camera camera;
    std::uint32_t width = 0, height = 0;
    std::vector<std::uint32_t> channels;
    float pixels_per_voxel = 1;
};

struct PageWish {
    std::vector<WishedPage> pages;   // most wanted first
    std::vector<CameraView> views;   // at most one; served after `pages`
    std::uint64_t credit_bytes = 0;  // payload bytes there is room for
};

}  // namespace brickyard
