#include "client/frame_stream.h"

#include <fmt/format.h>

#include <algorithm>
#include <tuple>

#include "client/brick_page.h"
#include "client/elapsed.h"
#include "core/brick_codec.h"
#include "core/brick_store.h"

namespace brickyard {

namespace {

using Clock = std::chrono::steady_clock;

// A wish is answered in pieces; what arrives is drawn with after each wish, not after each piece.
constexpr std::size_t kMaxWishPages = 16384;

}  // namespace

Result<FrameFooter> FrameStream::open(std::uint32_t frame, SourceDeadline deadline) {
    Result<FrameFooter> footer = source_.openFrame(frame, deadline);
    if (!footer) return footer;
    frame_ = frame;
    // The newest: the frame may have come, or have been converted again, since the source was opened.
    const std::shared_ptr<const Manifest> manifest = source_.latestManifest();
    for (const FrameEntry& entry : manifest->frames())
        if (entry.frame() == frame) file_bytes_ = entry.file_bytes();
    return footer;
}

Result<void> FrameStream::begin(const FrameFooter& footer, std::uint64_t cache_bytes, int components) {
    if (Result<void> begun = held_.begin(footer, file_bytes_, cache_bytes, components); !begun) return begun;
    counted_before_ = cache().counters();
    return {};
}

Result<PagedChannel*> FrameStream::channel(std::uint32_t index) {
    Result<PagedChannel*> channel = held_.channel(index);
    if (channel && !channelOf(index)) channels_.push_back(*channel);
    return channel;
}

PagedChannel* FrameStream::channelOf(std::uint32_t index) const {
    for (PagedChannel* channel : channels_)
        if (channel->index() == index) return channel;
    return nullptr;
}

Result<void> FrameStream::take(const PageWish& wish, SourceDeadline deadline) {
    if (Result<void> sent = source_.wish(wish); !sent) return sent;
    cache().beginPass();
    const Clock::time_point begin = Clock::now();
    std::optional<Clock::time_point> first;
    std::uint64_t before_first = 0;
    while (Clock::now() < deadline) {
        Result<std::vector<Arrival>> arrivals = source_.take(deadline);
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

void FrameStream::arrive(const Arrival& arrival) {
    const PageAddress& address = arrival.page.address;
    const WantedPage key{arrival.page.is_block, address};
    PagedChannel* channel = channelOf(address.channel);
    if (!channel) return;  // not asked for
    auto failed = [&](const std::string& why) {
        // Once more: a flipped bit on the way is not one on the disk.
        if (arrival.bytes && retried_.insert(key).second) return;
        if (!failed_.insert(key).second || !first_failure_.empty()) return;
        // A tree block's own words name it.
        const std::string brick =
            arrival.page.is_block ? ""
                                  : fmt::format("channel '{}': brick {} of tree block {}: ", channel->name(),
                                                address.node, address.block);
        first_failure_ = fmt::format("{}: frame {}: {}{}", source_.name(), frame_, brick, why);
    };
    if (!arrival.bytes) return failed(arrival.bytes.error().message);
    if (arrival.page.is_block) {
        if (Result<void> added = channel->addBlock(address.block, *arrival.bytes); !added)
            failed(added.error().message);
        return;
    }
    const TreeBlock* block = address.block < channel->blockCount() ? channel->block(address.block) : nullptr;
    if (!block || address.node >= block->nodeCount() || !block->record(address.node).hasBrick()) return;
    if (cache().contains(address)) return;
    const NodeRecord& record = block->record(address.node);
    if (address.draft && !record.hasDraft()) return;
    if (arrival.bytes->size() != (address.draft ? record.draft_bytes : record.payload_bytes) ||
        checksum(*arrival.bytes) != (address.draft ? record.draft_checksum : record.payload_checksum))
        return failed("fails its checksum; run `brickyard verify` on the dataset");
    // Decoded aside: a payload that is refused half-way must not leave half a brick in the cache.
    const int components = channel->components();
    std::vector<float> samples(channel->shape().samples() * std::size_t(components));
    const SampleType type = levelType(channel->type(), channel->levelOf({address.block, address.node}));
    const Result<void> decoded =
        address.draft ? decodeDraftToFloat(*arrival.bytes, channel->shape(), type, components, samples)
                      : decodeBrickToFloat(*arrival.bytes, channel->shape(), type, components, samples);
    if (!decoded) return failed(decoded.error().message);
    float* slot = cache().insert(address);
    if (!slot) return;  // no room now: it is wanted again
    float* end = std::copy(samples.begin(), samples.end(), slot);
    if (components == 1) *end = steepnessOf(samples, channel->shape());
    if (address.block == 0 && address.node < channel->roots().size()) cache().pin(address);
}

PageWish FrameStream::wishFor(const WantList& wants, std::uint64_t allowed_bytes, bool& over_budget) const {
    struct Ranked {
        WantedPage page;
        Want want;
    };
    std::vector<Ranked> ranked;
    for (const auto& [page, want] : wants.all()) ranked.push_back({page, want});
    // Where not all fits, the first tiles come first: they get done, and their pages may go. Else: most error
    // per byte.
    const std::size_t room = std::max<std::size_t>(1, cache().room());
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
    for (const Ranked& r : ranked) {
        if (!r.page.is_block && ++pages > room) break;
        if (wish.pages.size() >= kMaxWishPages) break;
        if (wish.credit_bytes + r.want.bytes > allowed_bytes) {
            over_budget = true;
            break;
        }
        wish.pages.push_back({r.page.is_block, r.page.address});
        wish.credit_bytes += r.want.bytes;
    }
    return wish;
}

}  // namespace brickyard
