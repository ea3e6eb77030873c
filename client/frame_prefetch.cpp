#include "client/frame_prefetch.h"

#include <algorithm>
#include <span>
#include <tuple>
#include <unordered_set>
#include <vector>

#include "client/arrived_nodes.h"
#include "client/frame_stream.h"

namespace brickyard {

namespace {

// A piece, and how long it may take: what end() waits for.
constexpr std::uint64_t kPieceBytes = 512u << 10;
constexpr std::chrono::seconds kPieceTime{2};

using Places = std::unordered_map<NodeKey, FrameUse::Pages, NodeKeyHash>;

// The places and all that lie above them.
std::unordered_set<NodeKey, NodeKeyHash> withAncestors(const Places& places) {
    std::unordered_set<NodeKey, NodeKeyHash> all;
    for (const auto& [place, pages] : places)
        for (NodeKey key = place; all.insert(key).second && key.level < kMaxLevel;) key = key.parent();
    return all;
}

// What is wanted of a channel.
struct ChannelLike {
    const PagedChannel* channel = nullptr;
    const Places* used = nullptr;
    std::unordered_set<NodeKey, NodeKeyHash> above;
    bool drafts = false;  // leaves may be drawn from their drafts
};

ChannelLike likeOf(const PagedChannel& channel, const Places& used) {
    return {&channel, &used, withAncestors(used),
            std::any_of(used.begin(), used.end(), [](const auto& place) { return place.second.draft; })};
}

struct Missing {
    WishedPage page;
    int level = 0;
    std::uint64_t bytes = 0;
};

// What of a channel should be there and is not.
void addMissing(const ChannelLike& like, const PageCache& cache, std::vector<Missing>& out) {
    const PagedChannel& channel = *like.channel;
    const auto wish = [&](const NodeRef& ref, const NodeKey& key, bool draft) {
        const NodeRecord& record = channel.block(ref.block)->record(ref.node);
        const PageAddress page{channel.index(), ref.block, ref.node, draft && record.hasDraft()};
        if (record.hasBrick() && !cache.contains(page))
            out.push_back({{false, page}, key.level, page.draft ? record.draft_bytes : record.payload_bytes});
    };
    std::unordered_set<std::uint32_t> blocks;
    forEachArrived(
        channel,
        [&](const NodeRef& ref, const NodeKey& key) {
            if (!like.above.contains(key)) return false;
            if (const auto found = like.used->find(key); found != like.used->end()) {
                if (found->second.whole) wish(ref, key, false);
                if (found->second.draft) wish(ref, key, true);
            } else if (key.level == 0 || channel.block(ref.block)->isLeaf(ref.node)) {
                // Where the frame before went deeper, a leaf stands for all that was below.
                wish(ref, key, like.drafts);
            }
            return true;
        },
        [&](std::uint32_t block) {
            if (block < channel.blockCount() && blocks.insert(block).second)
                out.push_back(
                    {{true, {channel.index(), block, 0}}, kMaxLevel + 1, channel.blockBytes(block)});
        });
}

// The next piece of what is missing, coarse before fine and tree blocks before all; takes it off `allowed`.
PageWish nextPiece(std::span<const ChannelLike> channels, const FrameStream& stream, std::uint64_t& allowed) {
    std::vector<Missing> missing;
    for (const ChannelLike& like : channels) addMissing(like, stream.cache(), missing);
    std::sort(missing.begin(), missing.end(), [](const Missing& a, const Missing& b) {
        const PageAddress &pa = a.page.address, &pb = b.page.address;
        return std::tie(b.level, pa.channel, pa.block, pa.node, pa.draft) <
               std::tie(a.level, pb.channel, pb.block, pb.node, pb.draft);
    });
    // Nothing makes way: what does not fit is the picture's to choose.
    const PageCache& cache = stream.cache();
    std::size_t room = cache.capacity() - std::min(cache.capacity(), cache.size());
    PageWish wish;
    for (const Missing& m : missing) {
        if (stream.failed().contains({m.page.is_block, m.page.address})) continue;
        // At least 1, so that what never comes is not asked for for ever.
        const std::uint64_t bytes = std::max<std::uint64_t>(1, m.bytes);
        if (bytes > allowed || (!m.page.is_block && room == 0)) continue;
        if (!wish.pages.empty() && wish.credit_bytes + bytes > kPieceBytes) break;
        wish.pages.push_back(m.page);
        wish.credit_bytes += bytes;
        allowed -= bytes;
        if (!m.page.is_block) --room;
    }
    return wish;
}

}  // namespace

FrameUse useOf(const ResidentFrame& frame) {
    FrameUse use;
    if (!frame.begun()) return use;
    use.components = frame.components();
    for (const auto& [index, channel] : frame.channels()) {
        Places& places = use.channels[channel.name()];
        forEachArrived(
            channel,
            [&](const NodeRef& ref, const NodeKey& key) {
                const NodeRecord& record = channel.block(ref.block)->record(ref.node);
                for (const bool draft : {false, true}) {
                    if (!frame.cache().usedInPicture({index, ref.block, ref.node, draft})) continue;
                    (draft ? places[key].draft : places[key].whole) = true;
                    use.bytes += draft ? record.draft_bytes : record.payload_bytes;
                }
                return true;
            },
            [](std::uint32_t) {});
    }
    return use;
}

FramePrefetch::FramePrefetch(PrefetchRequest request)
    : request_(std::move(request)), thread_([this] {
          run();
          done_ = true;
      }) {}

void FramePrefetch::end() {
    stop_ = true;
    if (thread_.joinable()) thread_.join();
}

// Whatever goes wrong ends it: the picture meets the same, and tells.
void FramePrefetch::run() {
    FrameStream stream(*request_.source, request_.into);
    Result<FrameFooter> footer = stream.open(request_.frame, SourceDeadline::max());
    if (!footer || stop_) return;
    if (request_.bind && !request_.bind(*footer)) return;
    if (!stream.begin(*footer, request_.cache_bytes, request_.like.components)) return;

    std::vector<ChannelLike> channels;
    for (int i = 0; i < footer->channels_size(); ++i) {
        const auto used = request_.like.channels.find(footer->channels(i).name());
        if (used == request_.like.channels.end()) continue;
        const Result<PagedChannel*> channel = stream.channel(std::uint32_t(i));
        if (!channel) return;
        channels.push_back(likeOf(**channel, used->second));
    }
    std::uint64_t allowed = request_.max_bytes;
    while (!stop_) {
        const PageWish wish = nextPiece(channels, stream, allowed);
        if (wish.pages.empty()) return;
        if (!stream.take(wish, std::chrono::steady_clock::now() + kPieceTime)) return;
    }
}

}  // namespace brickyard
