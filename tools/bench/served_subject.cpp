#include "tools/bench/served_subject.h"

#include <algorithm>
#include <tuple>

#include "core/block_cache.h"
#include "core/dataset.h"
#include "tools/bench/bench_cache.h"
#include "tools/conversion.h"

namespace brickyard {
namespace {

constexpr std::uint64_t kTopologyBytes = 256u << 20;

Result<SubjectFrame> openServed(const Dataset& dataset, std::uint32_t number, const std::string& channel) {
    const auto store = dataset.openFrame(number);
    if (!store) return tl::unexpected(store.error());
    SubjectFrame frame;
    frame.frame = number;
    frame.reader = std::make_shared<FrameReader>(*store, std::make_shared<BlockCache>(kTopologyBytes));
    const FrameFooter& footer = (*store)->footer();
    while (footer.channels(int(frame.channel)).name() != channel) ++frame.channel;  // it was converted
    Result<PagedChannel> tree =
        PagedChannel::create(frame.footer(), frame.channel, int(footer.brick_edge()), (*store)->fileBytes());
    if (!tree) return tl::unexpected(tree.error());
    for (std::uint32_t b = 0; b < tree->blockCount(); ++b) {
        const Result<std::vector<std::byte>> stored = (*store)->readBlock(frame.channel, b);
        if (!stored) return tl::unexpected(stored.error());
        if (Result<void> added = tree->addBlock(b, *stored); !added) return tl::unexpected(added.error());
    }
    frame.tree = std::make_shared<const PagedChannel>(std::move(*tree));
    return frame;
}

}  // namespace

Result<ServedSubject> convertServed(const BenchOptions& options) {
    const Result<std::vector<BenchCache>> caches = findCaches(options.data);
    if (!caches) return tl::unexpected(caches.error());
    const BenchCache& cache = caches->front();
    options.progress("converting " + cache.name);

    ServedSubject subject;
    subject.cache = cache.name;
    subject.folder = options.scratch / "served.bricks";
    ConversionOptions conversion;
    for (const std::filesystem::path& file : sequenceOf(cache)) conversion.inputs.push_back(file.string());
    conversion.output = subject.folder;
    conversion.channels = {cache.channel};
    const Result<ConversionReport> report = convert(conversion);
    if (!report) return tl::unexpected(report.error());

    const Result<Dataset> dataset = Dataset::open(subject.folder);
    if (!dataset) return tl::unexpected(dataset.error());
    for (const FrameEntry& entry : dataset->manifest().frames()) {
        Result<SubjectFrame> frame = openServed(*dataset, entry.frame(), cache.channel);
        if (!frame) return tl::unexpected(frame.error());
        subject.payload_bytes += frame->footer().payload_bytes();
        subject.frames.push_back(std::move(*frame));
    }
    return subject;
}

EveryPage everyPage(const SubjectFrame& frame) {
    struct Node {
        WishedPage page;
        std::uint32_t bytes = 0;
        int level = 0;
    };
    std::vector<Node> nodes;
    EveryPage every;
    for (std::uint32_t b = 0; b < frame.tree->blockCount(); ++b) {
        every.pages.push_back({true, {frame.channel, b, 0}});
        every.bytes += frame.tree->blockBytes(b);
        const TreeBlock& block = *frame.tree->block(b);
        for (std::uint32_t n = 0; n < block.nodeCount(); ++n)
            if (block.record(n).hasBrick())
                nodes.push_back({{false, {frame.channel, b, n}},
                                 block.record(n).payload_bytes,
                                 frame.tree->levelOf({b, n})});
    }
    std::sort(nodes.begin(), nodes.end(), [](const Node& a, const Node& b) {
        const PageAddress &pa = a.page.address, &pb = b.page.address;
        return std::tuple(-a.level, pa.block, pa.node) < std::tuple(-b.level, pb.block, pb.node);
    });
    for (const Node& node : nodes) {
        every.pages.push_back(node.page);
        every.bytes += node.bytes;
    }
    return every;
}

}  // namespace brickyard
