// A client's wish as the message that carries it, and what is left of one. docs/protocol.md, "Wishes". Pure
// functions, any thread.
#pragma once

#include <cstdint>
#include <unordered_set>
#include <vector>

#include "client/brick_source.h"
#include "core/page_address.h"
#include "core/page_wish.h"
#include "proto/stream.pb.h"

namespace brickyard {

// Bricks and tree blocks that need not be asked for again.
class PageSet {
public:
    // False where it was in there already.
    bool insert(const WishedPage& page) {
        return (page.is_block ? blocks_ : bricks_).insert(page.address).second;
    }
    bool contains(const WishedPage& page) const {
        return (page.is_block ? blocks_ : bricks_).contains(page.address);
    }
    bool empty() const { return bricks_.empty() && blocks_.empty(); }
    void clear() { bricks_.clear(), blocks_.clear(); }

private:
    std::unordered_set<PageAddress, PageAddressHash> bricks_, blocks_;
};

// The front of a wish that fits one message. Epoch, dataset, frame and credit are left to whoever sends it.
Wish wishMessage(const PageWish& list);
// The same for what a client wishes before it has seen the footer.
Wish wishMessage(const StartView& view);
// Of the pages it names, those that are not in `had` stay.
void dropPages(Wish& wish, const PageSet& had);

// What the server makes of `view` in this frame: the channels that its names mean, and the camera.
CameraView resolveStartView(const StartView& view, const FrameFooter& footer);
bool sameView(const CameraView& a, const CameraView& b);

}  // namespace brickyard
