// The pages of a picture: what is asked for, in which order, and how what comes is checked and kept.

#include <fmt/format.h>

#include "client/brick_page.h"
#include "client/cpu/cpu_picture.h"
#include "client/cpu/page_order.h"
#include "core/brick_codec.h"
#include "core/brick_store.h"

namespace brickyard {

namespace {

using Clock = std::chrono::steady_clock;

// A wish is answered in pieces; what arrives is drawn with after each wish, not after each piece.
constexpr std::size_t kMaxWishPages = 16384;
// With limits: a batch is a share of what came before, so that the order stays current and round trips stay
// few.
constexpr std::uint64_t kLeastBatchBytes = 16u << 10, kBatchShare = 6;
// At most this much, or as much as came before, is asked for to fill a network that is far.
constexpr std::uint64_t kMostToFillBytes = 64u << 10;

}  // namespace

// A first wish that needs no knowledge: the top of each tree, and an overview of what the camera sees.
Result<void> CpuPicture::take(const PageWish& wish) {
    if (Result<void> sent = source_.wish(wish); !sent) return sent;
    cache_->beginPass();
    const Clock::time_point begin = Clock::now();
    std::optional<Clock::time_point> first;
    std::uint64_t before_first = 0;
    while (!late()) {
        Result<std::vector<Arrival>> arrivals = source_.take(deadline());
        if (!arrivals) return tl::unexpected(arrivals.error());
        if (arrivals->empty()) break;
        if (!first) {
            first = Clock::now();
            before_first = source_.counters().bytes_streamed;
        }
        for (const Arrival& arrival : *arrivals) arrive(arrival);
    }
    // What the network carries while an answer is waited for.
    if (first) {
        const double wait = std::chrono::duration<double>(*first - begin).count();
        const double rest = std::max(secondsSince(*first), 1e-6);
        in_flight_bytes_ =
            std::uint64_t(wait / rest * double(source_.counters().bytes_streamed - before_first));
    }
    return {};
}

void CpuPicture::arrive(const Arrival& arrival) {
    const PageAddress& address = arrival.page.address;
    const WantedPage key{arrival.page.is_block, address};
    PagedChannel* channel = channelOf(address.channel);
    if (!channel) return;  // not asked for
    auto failed = [&](const std::string& why) {
        // Once more: a flipped bit on the way is not one on the disk.
        if (arrival.bytes && retried_.insert(key).second) return;
        if (!failed_.insert(key).second || !outcome_.first_failure.empty()) return;
        // A tree block's own words name it.
        const std::string brick =
            arrival.page.is_block ? ""
                                  : fmt::format("channel '{}': brick {} of tree block {}: ", channel->name(),
                                                address.node, address.block);
        outcome_.first_failure =
            fmt::format("{}: frame {}: {}{}", source_.name(), request_.frame, brick, why);
    };
    if (!arrival.bytes) return failed(arrival.bytes.error().message);
    if (arrival.page.is_block) {
        if (Result<void> added = channel->addBlock(address.block, *arrival.bytes); !added)
            failed(added.error().message);
        return;
    }
    const TreeBlock* block = address.block < channel->blockCount() ? channel->block(address.block) : nullptr;
    if (!block || address.node >= block->nodeCount() || !block->record(address.node).hasBrick()) return;
    if (cache_->contains(address)) return;
    const NodeRecord& record = block->record(address.node);
    if (address.draft && !record.hasDraft()) return;
    if (arrival.bytes->size() != (address.draft ? record.draft_bytes : record.payload_bytes) ||
        checksum(*arrival.bytes) != (address.draft ? record.draft_checksum : record.payload_checksum))
        return failed("fails its checksum; run `brickyard verify` on the dataset");
    // Decoded aside: a payload that is refused half-way must not leave half a brick in the cache.
    std::vector<float> samples(channel->shape().samples());
    const SampleType type = levelType(channel->type(), channel->levelOf({address.block, address.node}));
    const Result<void> decoded = address.draft
                                     ? decodeDraftToFloat(*arrival.bytes, channel->shape(), type, 1, samples)
                                     : decodeBrickToFloat(*arrival.bytes, channel->shape(), type, 1, samples);
    if (!decoded) return failed(decoded.error().message);
    float* slot = cache_->insert(address);
    if (!slot) return;  // no room now: it is wanted again
    *std::copy(samples.begin(), samples.end(), slot) = steepnessOf(samples, channel->shape());
    if (address.block == 0 && address.node < channel->roots().size()) cache_->pin(address);
}

Result<bool> CpuPicture::stream() {
    struct Ranked {
        WantedPage page;
        Want want;
    };
    std::vector<Ranked> ranked;
    for (const auto& [page, want] : wants_.all()) ranked.push_back({page, want});
    if (ranked.empty()) return false;
    // Where not all fits, the first tiles come first: they get done, and their pages may go. Else: most error
    // per byte.
    const std::size_t room = std::max<std::size_t>(1, cache_->room());
    const bool all_fit = ranked.size() <= std::min(room, kMaxWishPages);
    std::sort(ranked.begin(), ranked.end(), [&](const Ranked& a, const Ranked& b) {
        if (a.page.is_block != b.page.is_block) return a.page.is_block;
        if (!all_fit && a.want.tile != b.want.tile) return a.want.tile < b.want.tile;
        const double worth_a = a.want.worth / double(a.want.bytes + 1),
                     worth_b = b.want.worth / double(b.want.bytes + 1);
        if (worth_a != worth_b) return worth_a > worth_b;
        const PageAddress &pa = a.page.address, &pb = b.page.address;
        return std::tie(pa.channel, pa.block, pa.node) < std::tie(pb.channel, pb.block, pb.node);
    });

    PageWish wish;
    std::size_t pages = 0;
    const std::uint64_t streamed = source_.counters().bytes_streamed;
    const std::uint64_t allowed =
        request_.max_stream_bytes > streamed ? request_.max_stream_bytes - streamed : 0;
    for (const Ranked& r : ranked) {
        if (!r.page.is_block && ++pages > room) break;
        if (wish.pages.size() >= kMaxWishPages) break;
        if (wish.credit_bytes + r.want.bytes > allowed) {
            over_budget_ = true;
            break;
        }
        wish.pages.push_back({r.page.is_block, r.page.address});
        wish.credit_bytes += r.want.bytes;
    }
    if (wish.pages.empty()) return false;
    if (Result<void> taken = take(wish); !taken) return tl::unexpected(taken.error());
    return true;
}

// With a limit of bytes or time: coarse first, and then always what takes off most expected error per byte, a
// batch at a time, until the limit, the quality or the data end it.
Result<void> CpuPicture::refineWithinLimits() {
    const double target = plan_.quality.max_error / 3;
    while (!late()) {
        const Clock::time_point begin = Clock::now();
        drawProvisional(/*everything=*/true);
        outcome_.seconds_render += secondsSince(begin);
        ++outcome_.passes;
        if (outcome_.passes == 1) outcome_.seconds_first_image = secondsSince(begin_);
        const std::vector<Pixel>& pixels = outcome_.picture.pixels;
        const bool content = !plan_.quality.reference && !plan_.quality.strict &&
                             std::all_of(pixels.begin(), pixels.end(), [&](const Pixel& pixel) {
                                 return double(pixel.estimate_alpha) <= target;
                             });
        const std::size_t room = cache_->capacity() - std::min(cache_->capacity(), cache_->size());
        if (content || room == 0) return {};

        std::vector<float> transmittance;
        transmittance.reserve(pixels.size());
        for (const Pixel& pixel : pixels) transmittance.push_back(1 - pixel.alpha);
        const std::uint64_t streamed = source_.counters().bytes_streamed;
        PlanRequest asked;
        asked.scale = plan_.scene.density_scale;
        asked.transmittance = transmittance;
        asked.failed = [&](const WantedPage& page) { return failed_.contains(page); };
        asked.batch_bytes = std::max<std::uint64_t>(kLeastBatchBytes, streamed / kBatchShare);
        // Where time counts and bytes do not, no smaller batch than a far network carries in a round trip;
        // but the order of a large one is soon out of date.
        if (request_.max_stream_bytes == UINT64_MAX)
            asked.batch_bytes =
                std::max(asked.batch_bytes, std::min(in_flight_bytes_, std::max(kMostToFillBytes, streamed)));
        asked.max_bytes = request_.max_stream_bytes - std::min(streamed, request_.max_stream_bytes);
        const PagePlan plan = planPages(*density_, *plan_.camera, residentTree(), asked);
        over_budget_ |= plan.over_budget;
        PageWish wish;
        for (const PlannedPage& page : plan.pages) {
            if (wish.pages.size() >= room) break;
            wish.pages.push_back({page.page.is_block, page.page.address});
            wish.credit_bytes += page.bytes;
        }
        if (wish.pages.empty()) return {};
        if (Result<void> taken = take(wish); !taken) return taken;
        if (request_.progress) request_.progress(0, pixels.size(), source_.counters().bytes_streamed);
    }
    return {};
}

}  // namespace brickyard
