// A source in front of another one: what a test does not override goes straight through.
#pragma once

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "client/brick_source.h"

namespace brickyard {

class ForwardingSource : public BrickSource {
public:
    explicit ForwardingSource(std::unique_ptr<BrickSource> inner) : inner_(std::move(inner)) {}

    std::string name() const override { return inner_->name(); }
    const Manifest& manifest() const override { return inner_->manifest(); }
    std::shared_ptr<const Manifest> latestManifest() const override { return inner_->latestManifest(); }
    Result<bool> waitForChange(SourceDeadline deadline) override { return inner_->waitForChange(deadline); }
    Result<FrameFooter> openFrame(std::uint32_t frame,
                                  SourceDeadline deadline = SourceDeadline::max()) override {
        return inner_->openFrame(frame, deadline);
    }
    Result<void> wish(PageWish newest) override { return inner_->wish(std::move(newest)); }
    Result<std::vector<Arrival>> take(SourceDeadline deadline) override { return inner_->take(deadline); }
    bool wishDone() const override { return inner_->wishDone(); }
    SourceCounters counters() const override { return inner_->counters(); }

protected:
    std::unique_ptr<BrickSource> inner_;
};

}  // namespace brickyard
