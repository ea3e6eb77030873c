// A field that refuses to be read on once somebody wants to stop: so a conversion ends between two bricks,
// without the builder knowing of it.
#pragma once

#include <functional>

#include "core/field_source.h"

namespace brickyard {

class StoppableField final : public FieldSource {
public:
    // Keeps a reference to `source`. `stop` is asked from any thread.
    StoppableField(const FieldSource& source, std::function<bool()> stop)
        : source_(source), stop_(std::move(stop)) {}

    const ChannelInfo& info() const override { return source_.info(); }
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override {
        return source_.uniformOver(box);
    }
    Result<void> read(const IndexBox& box, SampleBlock& out) const override {
        if (stop_ && stop_()) return fail(ErrorCode::kRefused, "stopped; run the same command again");
        return source_.read(box, out);
    }
    bool prefersRows() const override { return source_.prefersRows(); }
    void release() const override { source_.release(); }

private:
    const FieldSource& source_;
    std::function<bool()> stop_;
};

}  // namespace brickyard
