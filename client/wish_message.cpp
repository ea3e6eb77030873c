#include "client/wish_message.h"

#include <algorithm>
#include <optional>

#include "core/camera_framing.h"
#include "core/default_density.h"
#include "core/stream_frame.h"

namespace brickyard {
namespace {

// Limits of stream.proto: what is over them would end the connection.
constexpr int kMaxWishPages = 65536;
constexpr int kMaxWishBlocks = 4096;
// Room in a message for length, epoch, dataset, frame and credit, which are filled in later.
constexpr std::size_t kReservedBytes = 96;

WishedPage pageOf(const PageRef& ref) {
    return {false, {ref.channel(), ref.block(), ref.node(), ref.draft()}};
}
WishedPage pageOf(const BlockWish& block) { return {true, {block.channel(), block.block(), 0}}; }

template <class Repeated>
void dropFrom(Repeated& named, const PageSet& had) {
    int kept = 0;
    for (int i = 0; i < named.size(); ++i)
        if (!had.contains(pageOf(named[i]))) named.SwapElements(kept++, i);
    named.DeleteSubrange(kept, named.size() - kept);
}

}  // namespace

Wish wishMessage(const PageWish& list) {
    Wish wish;
    for (const WishedPage& page : list.pages) {
        if (page.is_block && wish.blocks_size() < kMaxWishBlocks) {
            BlockWish& block = *wish.add_blocks();
            block.set_channel(page.address.channel);
            block.set_block(page.address.block);
        } else if (!page.is_block && wish.pages_size() < kMaxWishPages) {
            PageRef& ref = *wish.add_pages();
            ref.set_channel(page.address.channel);
            ref.set_block(page.address.block);
            ref.set_node(page.address.node);
            ref.set_draft(page.address.draft);
        }
    }
    if (!list.views.empty()) {
        const CameraView& view = list.views.front();
        CameraWish& seen = *wish.mutable_camera();
        *seen.mutable_camera() = view.camera;
        seen.set_width(view.width);
        seen.set_height(view.height);
        for (const std::uint32_t channel : view.channels) seen.add_channels(channel);
        seen.set_pixels_per_voxel(view.pixels_per_voxel);
    }
    while (wish.ByteSizeLong() + kReservedBytes > kMaxClientMessageBytes && wish.pages_size() > 0)
        wish.mutable_pages()->DeleteSubrange(wish.pages_size() - wish.pages_size() / 8 - 1,
                                             wish.pages_size() / 8 + 1);
    return wish;
}

Wish wishMessage(const StartView& view) {
    Wish wish;
    CameraWish& seen = *wish.mutable_camera();
    if (view.camera) *seen.mutable_camera() = *view.camera;
    seen.set_width(view.width);
    seen.set_height(view.height);
    for (const std::string& name : view.channels) seen.add_channel_names(name);
    seen.set_pixels_per_voxel(view.pixels_per_voxel);
    return wish;
}

void dropPages(Wish& wish, const PageSet& had) {
    if (had.empty()) return;
    dropFrom(*wish.mutable_pages(), had);
    dropFrom(*wish.mutable_blocks(), had);
}

CameraView resolveStartView(const StartView& view, const FrameFooter& footer) {
    CameraView seen;
    seen.width = view.width;
    seen.height = view.height;
    seen.pixels_per_voxel = view.pixels_per_voxel;
    const auto see = [&](std::uint32_t channel) {
        if (std::find(seen.channels.begin(), seen.channels.end(), channel) == seen.channels.end())
            seen.channels.push_back(channel);
    };
    for (const std::string& name : view.channels) {
        if (name.empty())
            if (const auto density = defaultDensity(footer)) see(*density);
        for (int i = 0; i < footer.channels_size() && !name.empty(); ++i)
            if (footer.channels(i).name() == name) see(std::uint32_t(i));
    }
    if (view.camera)
        seen.camera = *view.camera;
    else if (!seen.channels.empty())
        seen.camera = frameChannel(footer.channels(int(seen.channels.front())),
                                   double(view.width) / double(view.height));
    return seen;
}

bool sameView(const CameraView& a, const CameraView& b) {
    return a.width == b.width && a.height == b.height && a.channels == b.channels &&
           a.pixels_per_voxel == b.pixels_per_voxel &&
           a.camera.SerializeAsString() == b.camera.SerializeAsString();
}

}  // namespace brickyard
