// Messages of the stream as a client might send them, made from random numbers: what a fuzzer that only flips
// bytes would take for ever to find. Numbers are small where the receiver looks something up by them.
#pragma once

#include <cstdint>
#include <string>

#include "proto/stream.pb.h"

namespace brickyard {

// SplitMix64: enough for this, and cheap to seed.
class Dice {
public:
    explicit Dice(std::uint64_t seed) : state_(seed) {}
    std::uint64_t next() {
        std::uint64_t z = state_ += 0x9e3779b97f4a7c15ull;
        z = (z ^ z >> 30) * 0xbf58476d1ce4e5b9ull;
        z = (z ^ z >> 27) * 0x94d049bb133111ebull;
        return z ^ z >> 31;
    }
    // In [0, n).
    std::uint32_t below(std::uint32_t n) { return std::uint32_t(next() % n); }
    bool once(std::uint32_t in) { return below(in) == 0; }

private:
    std::uint64_t state_;
};

inline void addCamera(Dice& dice, Wish& wish) {
    CameraWish& seen = *wish.mutable_camera();
    seen.set_width(dice.once(8) ? std::uint32_t(dice.next()) : 1 + dice.below(2000));
    seen.set_height(dice.once(8) ? 0 : 1 + dice.below(2000));
    for (std::uint32_t n = dice.below(3); n > 0; --n) seen.add_channels(dice.below(3));
    for (std::uint32_t n = dice.below(3); n > 0; --n)
        seen.add_channel_names(dice.once(2) ? "" : dice.once(2) ? "heat" : "none");
    if (dice.once(4)) seen.set_pixels_per_voxel(float(dice.below(9)) - 1);
    if (dice.once(2)) return;
    for (int axis = 0; axis < 3; ++axis) {
        seen.mutable_camera()->add_eye(double(dice.below(200)) - 50);
        seen.mutable_camera()->add_target(16);
    }
}

inline Wish randomWish(Dice& dice) {
    Wish wish;
    wish.set_epoch(dice.once(8) ? dice.next() : dice.below(40));
    wish.set_dataset_id(dice.once(8) ? dice.below(4) : 1);
    wish.set_frame(dice.once(8) ? dice.below(40) : 30);
    wish.set_first_frame(dice.once(8));
    wish.set_credit_bytes(dice.once(4) ? dice.next() : dice.below(3000));
    for (std::uint32_t n = dice.below(3); n > 0; --n) {
        BlockWish& block = *wish.add_blocks();
        block.set_channel(dice.below(3));
        block.set_block(dice.below(3));
    }
    for (std::uint32_t n = dice.below(12); n > 0; --n) {
        PageRef& page = *wish.add_pages();
        page.set_channel(dice.below(3));
        page.set_block(dice.once(8) ? std::uint32_t(dice.next()) : dice.below(2));
        page.set_node(dice.once(8) ? std::uint32_t(dice.next()) : dice.below(80));
        page.set_draft(dice.once(8));
    }
    if (dice.once(3)) addCamera(dice, wish);
    return wish;
}

inline StreamHeader randomMessage(Dice& dice) {
    StreamHeader header;
    switch (dice.below(8)) {
        case 0:
        case 1: {
            Hello& hello = *header.mutable_hello();
            hello.set_protocol_major(dice.once(8) ? dice.below(3) : 1);
            hello.set_protocol_minor(dice.below(3));
            hello.set_token(dice.once(2) ? "all" : dice.once(2) ? "narrow" : "");
            hello.set_client("fuzz");
            break;
        }
        case 2: header.mutable_open()->set_dataset(dice.once(3) ? "other" : "tiny"); break;
        case 3:
            header.mutable_open_frame()->set_dataset_id(1 + dice.below(2));
            header.mutable_open_frame()->set_frame(dice.once(4) ? dice.below(40) : 30);
            header.mutable_open_frame()->set_first_frame(dice.once(4));
            break;
        case 4: header.mutable_ping()->set_number(dice.next()); break;
        // What only servers send.
        case 5:
            if (dice.once(4)) {
                header.mutable_failed()->set_message(std::string(dice.below(200), 'x'));
                break;
            }
            [[fallthrough]];
        default: *header.mutable_wish() = randomWish(dice);
    }
    return header;
}

}  // namespace brickyard
