// A stored frame whose pages come as something reads it, for tests of what reads it.
#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "client/cpu/channel_ray.h"
#include "client/frame_stream.h"
#include "stored_fields.h"

namespace brickyard {

class StreamedFrame {
public:
    // `components`: most of a channel.
    explicit StreamedFrame(const std::filesystem::path& folder, std::uint32_t frame = 0, int components = 1) {
        auto source = openSource(folder.string(), "");
        EXPECT_TRUE(source) << source.error().message;
        source_ = std::move(*source);
        stream_ = std::make_unique<FrameStream>(*source_, nullptr);
        const auto footer = stream_->open(frame, SourceDeadline::max());
        EXPECT_TRUE(footer) << footer.error().message;
        EXPECT_TRUE(stream_->begin(*footer, 256u << 20, components));
        for (int c = 0; c < footer->channels_size(); ++c)
            channels_.push_back(*stream_->channel(std::uint32_t(c)));
    }
    const PagedChannel& channel(std::size_t index = 0) const { return *channels_[index]; }
    // What is wanted goes to wants().
    RayContext context() {
        RayContext context;
        context.cache = &stream_->cache();
        context.failed = &stream_->failed();
        context.wants = &wants_;
        return context;
    }
    WantList& wants() { return wants_; }
    // What is wanted arrives. False where nothing was.
    bool arrive() {
        if (wants_.empty()) return false;
        bool over_budget = false;
        const PageWish wish = stream_->wishFor(wants_, UINT64_MAX, over_budget);
        EXPECT_FALSE(wish.pages.empty());
        EXPECT_TRUE(stream_->take(wish, SourceDeadline::max()));
        wants_.clear();
        stream_->cache().beginPass();
        return true;
    }

private:
    std::unique_ptr<BrickSource> source_;
    std::unique_ptr<FrameStream> stream_;
    std::vector<PagedChannel*> channels_;
    WantList wants_;
};

// Reads until nothing is missing: `read()` gives something with takeMissed() and is called anew after each
// arrival.
template <class Read>
void readUntilThere(std::vector<StreamedFrame*> frames, Read read) {
    for (int rounds = 0; rounds < 100; ++rounds) {
        read();
        bool arrived = false;
        for (StreamedFrame* frame : frames) arrived |= frame->arrive();
        if (!arrived) return;
    }
    FAIL() << "something is wanted for ever";
}

}  // namespace brickyard
