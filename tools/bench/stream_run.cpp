#include "tools/bench/stream_run.h"

#include <algorithm>
#include <chrono>
#include <queue>
#include <tuple>
#include <unordered_set>

#include "tools/bench/stream_picture.h"

namespace brickyard {

namespace {

constexpr std::uint64_t kLeastBatch = 2048;
// A ray counts as opaque for GigaVoxels' order below this.
constexpr double kOpaque = 0.01;

}  // namespace

std::uint64_t StreamRun::bytesTo(double psnr) const {
    for (const StreamPoint& point : points)
        if (point.psnr >= psnr) return point.bytes;
    return 0;
}

StreamRun runOrder(const StreamTable& table, const BrickStore& store, const PinholeCamera& camera,
                   PageOrder order, const StreamRunOptions& options) {
    StreamRun run;
    const FrameFooter& footer = store.footer();
    const std::uint32_t index = table.channel().index();
    // Its topology arrives as it is asked for.
    Result<PagedChannel> channel =
        PagedChannel::create(footer.channels(int(index)), index, int(footer.brick_edge()), store.fileBytes());
    std::unordered_set<PageAddress, PageAddressHash> resident;
    StreamPicture picture(table);
    std::uint64_t bytes = 0;
    std::vector<double> seconds;
    while (channel && picture.psnr() < options.stop_psnr) {
        const auto begin = std::chrono::steady_clock::now();
        const ResidentTree tree(*channel, [&](const PageAddress& page) { return resident.contains(page); });
        const std::vector<float> transmittance = picture.transmittance();
        const std::vector<float> opaque = picture.opaqueDistance(kOpaque);
        PlanRequest request;
        request.order = order;
        request.scale = options.scale;
        request.transmittance = transmittance;
        request.opaque_distance = opaque;
        request.batch_bytes = std::max(kLeastBatch, std::uint64_t(double(bytes) * options.batch_share));
        const PagePlan plan = planPages(*channel, camera, tree, request);
        seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
        if (plan.pages.empty()) break;
        ++run.plans;
        for (const PlannedPage& planned : plan.pages) {
            bytes += planned.bytes;
            const PageAddress& page = planned.page.address;
            if (planned.page.is_block) {
                const Result<std::vector<std::byte>> stored = store.readBlock(index, page.block);
                if (!stored || !channel->addBlock(page.block, *stored)) return run;
            } else {
                resident.insert(page);
                const std::uint32_t node = table.find({page.block, page.node});
                if (node != StreamNode::kNoStreamNode) picture.add({node, page.draft});
            }
            run.points.push_back({bytes, picture.psnr(), picture.worst()});
        }
    }
    if (!seconds.empty()) {
        std::nth_element(seconds.begin(), seconds.begin() + std::ptrdiff_t(seconds.size() / 2),
                         seconds.end());
        run.plan_seconds = seconds[seconds.size() / 2];
    }
    return run;
}

namespace {

// What a greedy oracle chooses from, and by.
enum class OracleKind {
    kSingle,    // single pages
    kTogether,  // these, and a node's children together
    kOwnError,  // single pages, by their own error: no page is taken for making up for another's
};

class Oracle {
public:
    Oracle(const StreamTable& table, const StreamRunOptions& options, OracleKind kind)
        : table_(table),
          options_(options),
          kind_(kind),
          picture_(table),
          blocks_(table.channel().blockCount(), false),
          children_(table.nodes().size()) {}

    StreamRun run() {
        for (std::uint32_t n = 0; n < table_.nodes().size(); ++n) {
            const StreamNode& node = table_.nodes()[n];
            if (node.parent == StreamNode::kNoStreamNode)
                take({0, {{n, node.draft_bytes > 0}}});
            else
                children_[node.parent].push_back(n);
        }
        std::size_t steps = 0;
        while (picture_.psnr() < options_.stop_psnr) {
            // Squared error is no sum over pages: a page may gain from another one.
            if (steps++ % refreshEvery() == 0) refresh();
            if (!takeBest()) {
                if (steps % refreshEvery() == 1) break;
                steps = 0;
            }
        }
        return std::move(run_);
    }

private:
    struct Step {
        double rate = 0;
        std::vector<StreamPage> pages;
    };
    struct Less {
        bool operator()(const Step& a, const Step& b) const {
            if (a.rate != b.rate) return a.rate < b.rate;
            return std::tuple(a.pages.size(), a.pages[0].node, a.pages[0].draft) >
                   std::tuple(b.pages.size(), b.pages[0].node, b.pages[0].draft);
        }
    };

    std::size_t refreshEvery() const { return 1 + table_.nodes().size() / 100; }

    // Blocks on the way to the pages that have not been loaded.
    std::vector<std::uint32_t> missingBlocks(const Step& step) const {
        std::vector<std::uint32_t> missing;
        for (const StreamPage& page : step.pages)
            for (std::uint32_t a = page.node; a != StreamNode::kNoStreamNode; a = table_.nodes()[a].parent) {
                const std::uint32_t block = table_.nodes()[a].ref.block;
                if (!blocks_[block] && std::find(missing.begin(), missing.end(), block) == missing.end())
                    missing.push_back(block);
            }
        return missing;
    }

    std::uint64_t bytesOf(const Step& step) const {
        std::uint64_t bytes = 0;
        for (std::uint32_t block : missingBlocks(step)) bytes += table_.channel().blockBytes(block);
        for (const StreamPage& page : step.pages) {
            const StreamNode& node = table_.nodes()[page.node];
            bytes += page.draft ? node.draft_bytes : node.payload_bytes;
        }
        return bytes;
    }

    void weigh(Step& step) {
        const double gain =
            kind_ == OracleKind::kOwnError ? picture_.ownGainOf(step.pages) : picture_.gainOf(step.pages);
        step.rate = gain / double(bytesOf(step));
    }

    void consider(std::vector<StreamPage> pages) {
        std::erase_if(pages, [&](const StreamPage& page) { return picture_.has(page); });
        if (pages.empty()) return;
        Step step{0, std::move(pages)};
        weigh(step);
        if (step.rate > 0) queue_.push(std::move(step));
    }

    void refresh() {
        queue_ = {};
        for (std::uint32_t n = 0; n < table_.nodes().size(); ++n) {
            if (table_.nodes()[n].draft_bytes > 0) consider({{n, true}});
            consider({{n, false}});
            if (kind_ != OracleKind::kTogether) continue;
            std::vector<StreamPage> together;
            for (std::uint32_t c : children_[n]) together.push_back({c, table_.nodes()[c].draft_bytes > 0});
            if (together.size() > 1) consider(std::move(together));
        }
    }

    bool takeBest() {
        while (!queue_.empty()) {
            Step best = queue_.top();
            queue_.pop();
            std::erase_if(best.pages, [&](const StreamPage& page) { return picture_.has(page); });
            if (best.pages.empty()) continue;
            weigh(best);
            if (!(best.rate > 0)) continue;
            if (!queue_.empty() && Less()(best, queue_.top())) {
                queue_.push(std::move(best));
                continue;
            }
            // Blocks that are paid for leave the choice open again: what was best for many pages may not be
            // best for one.
            if (const std::vector<std::uint32_t> missing = missingBlocks(best); !missing.empty()) {
                for (std::uint32_t block : missing) load(block);
                refresh();
                continue;
            }
            take(best);
            return true;
        }
        return false;
    }

    void load(std::uint32_t block) {
        bytes_ += table_.channel().blockBytes(block);
        blocks_[block] = true;
        run_.points.push_back({bytes_, picture_.psnr(), picture_.worst()});
    }

    void take(const Step& step) {
        for (std::uint32_t block : missingBlocks(step)) load(block);
        bytes_ += bytesOf(step);
        for (const StreamPage& page : step.pages) picture_.add(page);
        run_.points.push_back({bytes_, picture_.psnr(), picture_.worst()});
    }

    const StreamTable& table_;
    const StreamRunOptions& options_;
    const OracleKind kind_;
    StreamPicture picture_;
    std::vector<bool> blocks_;
    std::vector<std::vector<std::uint32_t>> children_;
    std::priority_queue<Step, std::vector<Step>, Less> queue_;
    std::uint64_t bytes_ = 0;
    StreamRun run_;
};

}  // namespace

StreamRun runOracle(const StreamTable& table, const StreamRunOptions& options) {
    // Greedy is not the best there is: of three greedy runs, whichever is ahead.
    std::vector<StreamPoint> all;
    for (OracleKind kind : {OracleKind::kSingle, OracleKind::kTogether, OracleKind::kOwnError}) {
        const StreamRun run = Oracle(table, options, kind).run();
        all.insert(all.end(), run.points.begin(), run.points.end());
    }
    std::sort(all.begin(), all.end(), [](const StreamPoint& a, const StreamPoint& b) {
        return std::tuple(a.bytes, -a.psnr) < std::tuple(b.bytes, -b.psnr);
    });
    StreamRun best;
    for (const StreamPoint& point : all)
        if (best.points.empty() || point.psnr > best.points.back().psnr) best.points.push_back(point);
    return best;
}

}  // namespace brickyard
