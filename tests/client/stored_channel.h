// A channel of a stored dataset, and as much of its pages as a test lets arrive.
#pragma once

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <unordered_set>

#include "client/brick_page.h"
#include "client/cpu/channel_ray.h"
#include "client/local_source.h"
#include "core/brick_codec.h"
#include "stored_fields.h"

namespace brickyard {

// A formula over a box, background around it.
class FormulaField final : public FieldSource {
public:
    using Formula = std::function<float(std::int64_t, std::int64_t, std::int64_t)>;
    // Active: where `formula` is not `background`. `transform`: 16 numbers, column-major; empty: identity.
    FormulaField(const IndexBox& box, float background, Formula formula,
                 const std::vector<double>& transform = {})
        : background_(background), formula_(std::move(formula)) {
        info_.name = "field";
        info_.background = {std::bit_cast<std::uint32_t>(background)};
        if (!transform.empty()) info_.index_to_world = *Affine::fromColumns(transform);
        IndexBox tight{box.end, box.begin};
        for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
            for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y)
                for (std::int64_t x = box.begin[0]; x < box.end[0]; ++x) {
                    if (formula_(x, y, z) == background) continue;
                    ++info_.active_voxels;
                    const Index3 p{x, y, z};
                    for (std::size_t a = 0; a < 3; ++a) {
                        tight.begin[a] = std::min(tight.begin[a], p[a]);
                        tight.end[a] = std::max(tight.end[a], p[a] + 1);
                    }
                }
        info_.active_box = tight;
    }
    float at(const Index3& p) const {
        return info_.active_box.contains(p) ? formula_(p[0], p[1], p[2]) : background_;
    }
    // Trilinear, in index space.
    double at(const glm::dvec3& p) const {
        const glm::dvec3 low = glm::floor(p), s = p - low;
        double sum = 0;
        for (int c = 0; c < 8; ++c) {
            double weight = 1;
            Index3 at_corner{};
            for (int a = 0; a < 3; ++a) {
                weight *= (c >> a & 1) ? s[a] : 1 - s[a];
                at_corner[std::size_t(a)] = std::int64_t(low[a]) + (c >> a & 1);
            }
            if (weight != 0) sum += weight * double(at(at_corner));
        }
        return sum;
    }
    const ChannelInfo& info() const override { return info_; }
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override {
        if (intersect(box, info_.active_box).empty()) return UniformRegion{info_.background, false};
        return std::nullopt;
    }
    Result<void> read(const IndexBox& box, SampleBlock& out) const override {
        out.values.clear();
        out.active.clear();
        for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
            for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y)
                for (std::int64_t x = box.begin[0]; x < box.end[0]; ++x) {
                    const float value = at(Index3{x, y, z});
                    const auto bytes = std::bit_cast<std::array<std::byte, 4>>(value);
                    out.values.insert(out.values.end(), bytes.begin(), bytes.end());
                    out.active.push_back(value != background_);
                }
        return {};
    }

private:
    float background_;
    Formula formula_;
    ChannelInfo info_;
};

class StoredChannel {
public:
    explicit StoredChannel(const FieldSource& field, double max_error = 0, std::uint64_t budget = 64u << 20) {
        const std::filesystem::path folder = scratch_ / "field.bricks";
        const auto stored = storeFields(folder, {&field}, /*edge=*/8, max_error);
        EXPECT_TRUE(stored) << stored.error().message;
        source_ = std::move(*LocalSource::open(folder));
        const FrameFooter footer = *source_->openFrame(0);
        channel_ = std::make_unique<PagedChannel>(
            *PagedChannel::create(footer.channels(0), 0, int(source_->manifest().brick_edge()), UINT64_MAX));
        cache_ = std::make_unique<PageCache>(budget, pageFloats(channel_->shape()));
    }
    const PagedChannel& channel() const { return *channel_; }
    PageCache& cache() { return *cache_; }
    // What is wanted goes to wants().
    RayContext context() {
        RayContext context;
        context.cache = cache_.get();
        context.failed = &failed_;
        context.wants = &wants_;
        return context;
    }
    WantList& wants() { return wants_; }
    // It cannot be had.
    void fail(const WantedPage& page) { failed_.insert(page); }

    // What is wanted arrives, but what has failed; at most `most` pages of it. False where
    // nothing was wanted.
    bool arrive(std::size_t most = SIZE_MAX) {
        PageWish wish;
        for (const auto& [page, want] : wants_.all()) {
            EXPECT_FALSE(failed_.contains(page)) << "wanted in vain";
            if (wish.pages.size() < most) wish.pages.push_back({page.is_block, page.address});
            wish.credit_bytes += want.bytes;
        }
        wants_.clear();
        take(wish);
        return !wish.pages.empty();
    }
    // All of the channel that has not failed.
    void arriveAll() {
        for (std::uint32_t b = 0; b < channel_->blockCount(); ++b) {
            PageWish wish;
            wish.credit_bytes = UINT64_MAX / 2;
            if (!channel_->block(b)) wish.pages.push_back({true, {0, b, 0}});
            take(wish);
            wish.pages.clear();
            for (std::uint32_t n = 0; n < channel_->block(b)->nodeCount(); ++n)
                if (channel_->block(b)->record(n).hasBrick() && !failed_.contains({false, {0, b, n}}) &&
                    !cache_->contains({0, b, n}))
                    wish.pages.push_back({false, {0, b, n}});
            take(wish);
        }
    }
    // Bricks that are there.
    std::size_t bricks() const { return cache_->size(); }
    // Everything is forgotten but the failures.
    void forget() { cache_ = std::make_unique<PageCache>(64u << 20, pageFloats(channel_->shape())); }

private:
    void take(const PageWish& wish) {
        if (wish.pages.empty()) return;
        ASSERT_TRUE(source_->wish(wish));
        for (;;) {
            const auto arrivals = source_->take(SourceDeadline::max());
            ASSERT_TRUE(arrivals);
            if (arrivals->empty()) break;
            for (const Arrival& arrival : *arrivals) {
                ASSERT_TRUE(arrival.bytes) << arrival.bytes.error().message;
                const PageAddress& address = arrival.page.address;
                if (arrival.page.is_block) {
                    ASSERT_TRUE(channel_->addBlock(address.block, *arrival.bytes));
                    continue;
                }
                if (cache_->contains(address)) continue;
                const int level = channel_->levelOf({address.block, address.node});
                std::vector<float> samples(channel_->shape().samples());
                ASSERT_TRUE(decodeBrickToFloat(*arrival.bytes, channel_->shape(),
                                               levelType(channel_->type(), level), 1, samples));
                float* slot = cache_->insert(address);
                ASSERT_TRUE(slot);
                *std::copy(samples.begin(), samples.end(), slot) = steepnessOf(samples, channel_->shape());
            }
        }
        cache_->beginPass();
    }

    ScratchFolder scratch_;
    std::unique_ptr<LocalSource> source_;
    std::unique_ptr<PagedChannel> channel_;
    std::unique_ptr<PageCache> cache_;
    std::unordered_set<WantedPage, WantedPageHash> failed_;
    WantList wants_;
};

}  // namespace brickyard
