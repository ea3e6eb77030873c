#include "tools/bench/picture_race.h"

#include <chrono>
#include <unordered_set>

#include "client/cpu/page_order.h"
#include "client/remote_source.h"
#include "client/renderer.h"
#include "tools/bench/stream_picture.h"

namespace brickyard {
namespace {

using Clock = std::chrono::steady_clock;

// The batches of the renderer, as client/cpu/cpu_picture_pages.cpp has them, and those of a client that knows
// that its server is far away.
constexpr std::uint64_t kLeastBatch = 16u << 10, kGreedyLeastBatch = 64u << 10;
constexpr double kBatchShare = 1.0 / 6, kGreedyBatchShare = 1;
constexpr std::uint64_t kEverything = 1ull << 32;

class Racer {
public:
    Racer(const RaceSetup& setup, RaceClient client) : setup_(setup), client_(client), picture_(setup.table) {
        const auto& nodes = setup.table.nodes();
        for (std::uint32_t n = 0; n < nodes.size(); ++n)
            if (nodes[n].parent == StreamNode::kNoStreamNode) roots_.push_back(n);
    }

    Result<RaceRun> run() {
        begin_ = Clock::now();
        const std::optional<StartHint> hint = startHintOf();
        auto source = RemoteSource::open(setup_.address, /*token=*/"", {}, hint);
        if (!source) return tl::unexpected(source.error());
        source_ = std::move(*source);
        const Result<FrameFooter> footer = source_->openFrame(setup_.frame.frame);
        if (!footer) return tl::unexpected(footer.error());
        const std::uint32_t index = setup_.frame.channel;
        Result<PagedChannel> channel =
            PagedChannel::create(footer->channels(int(index)), index, int(footer->brick_edge()),
                                 setup_.frame.reader->store().fileBytes());
        if (!channel) return tl::unexpected(channel.error());
        channel_.emplace(std::move(*channel));

        if (hint && hint->view) {
            const StartView& view = *hint->view;
            PageWish wish;
            wish.views.push_back({setup_.camera, view.width, view.height, {index}, view.pixels_per_voxel});
            wish.credit_bytes = view.credit_bytes;
            if (Result<void> taken = take(wish); !taken) return tl::unexpected(taken.error());
        }
        if (client_ == RaceClient::kGreedyPlans || client_ == RaceClient::kBreadthFirst)
            if (Result<void> taken = takeRoots(); !taken) return tl::unexpected(taken.error());
        while (!done()) {
            const PageWish wish = planned();
            if (wish.pages.empty()) break;
            if (Result<void> taken = take(wish); !taken) return tl::unexpected(taken.error());
        }
        run_.end = now();
        run_.psnr = picture_.psnr();
        return run_;
    }

private:
    std::optional<StartHint> startHintOf() const {
        const bool told = client_ == RaceClient::kCameraWish || client_ == RaceClient::kOverview ||
                          client_ == RaceClient::kOverviewGreedy;
        if (!told) return std::nullopt;
        RenderRequest request;
        request.width = setup_.pinhole.width();
        request.height = setup_.pinhole.height();
        request.camera = setup_.camera;
        request.scene.mutable_medium()->set_density(setup_.frame.footer().name());
        StartHint hint = startHint(request, setup_.frame.frame);
        if (client_ == RaceClient::kCameraWish && hint.view) {
            hint.view->pixels_per_voxel = 1;
            hint.view->credit_bytes = kEverything;
        }
        return hint;
    }

    // The footer names the roots, so that their block and their pages can be asked for together.
    Result<void> takeRoots() {
        PageWish wish;
        wish.credit_bytes = kEverything;
        wish.pages.push_back({true, {setup_.frame.channel, 0, 0}});
        for (std::uint32_t n = 0; n < channel_->roots().size(); ++n)
            wish.pages.push_back({false, {setup_.frame.channel, 0, n}});
        return take(wish);
    }

    PageWish planned() const {
        const ResidentTree tree(*channel_, [&](const PageAddress& page) { return resident_.contains(page); });
        const std::vector<float> transmittance = picture_.transmittance();
        PlanRequest request;
        request.scale = setup_.scale;
        request.transmittance = transmittance;
        if (client_ == RaceClient::kBreadthFirst) {
            request.order = PageOrder::kBreadthFirst;
            request.batch_bytes = kEverything;
        } else if (client_ == RaceClient::kGreedyPlans || client_ == RaceClient::kOverviewGreedy) {
            request.batch_bytes =
                std::max(kGreedyLeastBatch, std::uint64_t(kGreedyBatchShare * double(bytes_)));
        } else {
            request.batch_bytes = std::max(kLeastBatch, std::uint64_t(kBatchShare * double(bytes_)));
        }
        PageWish wish;
        for (const PlannedPage& page : planPages(*channel_, setup_.pinhole, tree, request).pages) {
            wish.pages.push_back({page.page.is_block, page.page.address});
            wish.credit_bytes += page.bytes;
        }
        return wish;
    }

    Result<void> take(const PageWish& wish) {
        if (Result<void> sent = source_->wish(wish); !sent) return sent;
        while (!done()) {
            const Result<std::vector<Arrival>> arrivals = source_->take(SourceDeadline::max());
            if (!arrivals) return tl::unexpected(arrivals.error());
            if (arrivals->empty()) break;
            for (const Arrival& arrival : *arrivals)
                if (Result<void> kept = arrive(arrival); !kept) return kept;
            note();
        }
        return {};
    }

    Result<void> arrive(const Arrival& arrival) {
        // A root of one value has no page.
        if (!arrival.bytes && arrival.bytes.error().code == ErrorCode::kNotFound) return {};
        if (!arrival.bytes) return tl::unexpected(arrival.bytes.error());
        bytes_ += arrival.bytes->size();
        const PageAddress& page = arrival.page.address;
        if (arrival.page.is_block) return channel_->addBlock(page.block, *arrival.bytes);
        resident_.insert(page);
        const std::uint32_t node = setup_.table.find({page.block, page.node});
        if (node != StreamNode::kNoStreamNode) picture_.add({node, page.draft});
        return {};
    }

    RaceMark now() const {
        return {std::chrono::duration<double>(Clock::now() - begin_).count(), bytes_,
                source_->counters().round_trips};
    }

    void note() {
        const auto drawn = [&](std::uint32_t root) { return picture_.has({root, true}); };
        if (!run_.first && std::all_of(roots_.begin(), roots_.end(), drawn)) run_.first = now();
        const double psnr = picture_.psnr();
        if (!run_.at_30_db && psnr >= 30) run_.at_30_db = now();
        if (!run_.at_40_db && psnr >= 40) run_.at_40_db = now();
    }

    bool done() const { return run_.first && picture_.psnr() >= setup_.stop_psnr; }

    const RaceSetup& setup_;
    const RaceClient client_;
    StreamPicture picture_;
    std::vector<std::uint32_t> roots_;  // in the table's nodes
    Clock::time_point begin_;
    std::unique_ptr<RemoteSource> source_;
    std::optional<PagedChannel> channel_;
    std::unordered_set<PageAddress, PageAddressHash> resident_;
    std::uint64_t bytes_ = 0;
    RaceRun run_;
};

}  // namespace

const char* toString(RaceClient client) {
    switch (client) {
        case RaceClient::kCameraWish: return "camera wish";
        case RaceClient::kOverview: return "overview, plans";
        case RaceClient::kOverviewGreedy: return "overview, plans doubling";
        case RaceClient::kPlans: return "plans";
        case RaceClient::kGreedyPlans: return "plans doubling";
        case RaceClient::kBreadthFirst: return "breadth-first";
    }
    return "";
}

Result<RaceRun> runRace(const RaceSetup& setup, RaceClient client) { return Racer(setup, client).run(); }

}  // namespace brickyard
