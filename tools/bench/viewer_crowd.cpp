#include "tools/bench/viewer_crowd.h"

#include <condition_variable>
#include <mutex>
#include <thread>

#include "client/brick_page.h"
#include "client/page_cache.h"
#include "client/remote_source.h"
#include "core/brick_codec.h"

namespace brickyard {

namespace {

using Clock = std::chrono::steady_clock;

constexpr std::uint64_t kCameraEvery = 8;
// A list names no more pages than this beyond what its credit is expected to bring.
constexpr std::size_t kMaxListed = 512;

}  // namespace

struct ViewerCrowd::Shared {
    StreamAddress address;
    const ServedSubject& subject;
    const std::vector<ViewerPath>& paths;
    ViewerSettings settings;
    std::size_t count = 0;

    std::mutex mutex;
    std::condition_variable changed;
    std::size_t ready = 0;
    bool begun = false;
    bool over = false;
    Clock::time_point begin;

    // False where it is over first.
    bool sleepUntil(Clock::time_point time) {
        std::unique_lock lock(mutex);
        return !changed.wait_until(lock, time, [&] { return over; });
    }
};

class ViewerCrowd::Viewer {
public:
    Viewer(Shared& shared, std::size_t number)
        : shared_(shared),
          number_(number),
          path_(shared.paths[number % shared.paths.size()]),
          frame_(shared.subject.frames[path_.frame]),
          shape_(frame_.tree->shape()),
          cache_(shared.settings.cache_bytes, pageFloats(shape_)),
          samples_(shape_.samples()),
          thread_([this] { run(); }) {}

    ViewerFigures figures() {
        thread_.join();
        return std::move(figures_);
    }

private:
    void run() {
        auto opened = open();
        {
            std::unique_lock lock(shared_.mutex);
            ++shared_.ready;
            shared_.changed.notify_all();
            shared_.changed.wait(lock, [&] { return shared_.begun || shared_.over; });
        }
        if (!opened) return fail(opened.error().message);
        // The wishes of all are spread over one pace, whatever the order of their threads.
        const auto pace = std::chrono::duration_cast<Clock::duration>(shared_.settings.pace);
        Clock::time_point due = shared_.begin + pace * std::int64_t(number_) / std::int64_t(shared_.count);
        for (std::uint64_t step = 0; shared_.sleepUntil(due); ++step) {
            if (!look(**opened, step, due)) return;
            due += pace;
            if (due < Clock::now()) ++figures_.late_wishes;
            // One that cannot keep up at all skips: it is not to be measured for ever after.
            while (due + 8 * pace < Clock::now()) due += pace;
        }
    }

    Result<std::unique_ptr<RemoteSource>> open() {
        auto source = RemoteSource::open(shared_.address, /*token=*/"");
        if (!source) return source;
        const Result<FrameFooter> footer = (*source)->openFrame(frame_.frame);
        if (!footer) return tl::unexpected(footer.error());
        return source;
    }

    // One wish and what comes for it. False where the viewer cannot go on.
    bool look(RemoteSource& source, std::uint64_t step, Clock::time_point due) {
        // Each begins elsewhere, and half of them go the other way.
        const std::size_t stations = path_.stations.size();
        const std::size_t at =
            (number_ * 7 + (number_ / 2 % 2 == 0 ? step : (stations - 1) * step)) % stations;
        cache_.beginPicture();
        PageWish wish = wishAt(path_.stations[at], step);
        if (wish.pages.empty() && wish.views.empty()) return true;
        if (Result<void> wished = source.wish(std::move(wish)); !wished)
            return fail(wished.error().message), false;
        ++figures_.wishes;
        bool first = true;
        const std::uint64_t lost = source.counters().reconnects;
        for (;;) {
            const Result<std::vector<Arrival>> arrivals = source.take(SourceDeadline::max());
            const Clock::time_point now = Clock::now();
            if (!arrivals) return fail(arrivals.error().message), false;
            if (arrivals->empty()) break;
            const float latency = std::chrono::duration<float, std::milli>(now - due).count();
            // The very first wish finds a cache that no memory stands behind yet, and all viewers begin at
            // once.
            std::vector<float>& firsts = step == 0 ? figures_.cold_ms : figures_.first_ms;
            if (std::exchange(first, false)) firsts.push_back(latency);
            for (const Arrival& arrival : *arrivals) {
                if (step > 0) figures_.page_ms.push_back(latency);
                accept(arrival);
            }
        }
        if (source.counters().reconnects != lost) fail("the connection was lost and made anew");
        return true;
    }

    PageWish wishAt(const ViewerStation& station, std::uint64_t step) {
        PageWish wish;
        wish.credit_bytes = shared_.settings.credit_bytes;
        if (step == 0 || (step + number_) % kCameraEvery == 0) {
            wish.views.push_back({station.camera, kViewerWidth, kViewerHeight, {frame_.channel}, 1});
            return wish;
        }
        std::uint64_t bytes = 0;
        for (const DescentStep& wanted : station.steps) {
            if (bytes >= wish.credit_bytes || wish.pages.size() >= kMaxListed) break;
            // Of what is there, the pages of this view are the last to go.
            if (wanted.is_block || cache_.find(wanted.page)) continue;
            wish.pages.push_back({false, wanted.page});
            bytes += wanted.bytes;
        }
        return wish;
    }

    void accept(const Arrival& arrival) {
        const PageAddress& page = arrival.page.address;
        if (!arrival.bytes) return fail(arrival.bytes.error().message);
        figures_.bytes += arrival.bytes->size();
        if (page.channel != frame_.channel || page.block >= frame_.tree->blockCount())
            return fail("a page came that the frame does not have");
        if (arrival.page.is_block) {
            ++figures_.blocks;
            if (checksum(*arrival.bytes) != frame_.footer().blocks(int(page.block)).xxh64())
                fail("a tree block fails its checksum");
            return;
        }
        ++figures_.pages;
        const TreeBlock& block = *frame_.tree->block(page.block);
        if (page.node >= block.nodeCount()) return fail("a page came that the block does not have");
        if (checksum(*arrival.bytes) != block.record(page.node).payload_checksum)
            return fail("a page fails its checksum");
        const SampleType type = levelType(frame_.tree->type(), frame_.tree->levelOf({page.block, page.node}));
        if (Result<void> decoded = decodeBrickToFloat(*arrival.bytes, shape_, type, 1, samples_); !decoded)
            return fail(decoded.error().message);
        if (cache_.contains(page)) return;
        if (float* slot = cache_.insert(page))
            *std::copy(samples_.begin(), samples_.end(), slot) = steepnessOf(samples_, shape_);
    }

    void fail(const std::string& why) {
        if (figures_.errors++ == 0) figures_.first_error = why;
    }

    Shared& shared_;
    const std::size_t number_;
    const ViewerPath& path_;
    const SubjectFrame& frame_;
    const BrickShape shape_;
    PageCache cache_;
    std::vector<float> samples_;
    ViewerFigures figures_;
    std::jthread thread_;
};

ViewerCrowd::ViewerCrowd(const StreamAddress& address, const ServedSubject& subject,
                         const std::vector<ViewerPath>& paths, std::size_t count,
                         const ViewerSettings& settings)
    : shared_(new Shared{address, subject, paths, settings, count, {}, {}, 0, false, false, {}}) {
    for (std::size_t i = 0; i < count; ++i) viewers_.push_back(std::make_unique<Viewer>(*shared_, i));
    std::unique_lock lock(shared_->mutex);
    shared_->changed.wait(lock, [&] { return shared_->ready == count; });
}

ViewerCrowd::~ViewerCrowd() {
    const std::lock_guard lock(shared_->mutex);
    shared_->over = true;
    shared_->changed.notify_all();
}

void ViewerCrowd::begin() {
    const std::lock_guard lock(shared_->mutex);
    shared_->begun = true;
    shared_->begin = Clock::now();
    shared_->changed.notify_all();
}

ViewerFigures ViewerCrowd::end() {
    {
        const std::lock_guard lock(shared_->mutex);
        shared_->over = true;
        shared_->changed.notify_all();
    }
    ViewerFigures sum;
    for (auto& viewer : viewers_) sum.add(viewer->figures());
    viewers_.clear();
    return sum;
}

void ViewerFigures::add(ViewerFigures&& other) {
    wishes += other.wishes;
    late_wishes += other.late_wishes;
    pages += other.pages;
    blocks += other.blocks;
    bytes += other.bytes;
    errors += other.errors;
    if (first_error.empty()) first_error = std::move(other.first_error);
    page_ms.insert(page_ms.end(), other.page_ms.begin(), other.page_ms.end());
    cold_ms.insert(cold_ms.end(), other.cold_ms.begin(), other.cold_ms.end());
    first_ms.insert(first_ms.end(), other.first_ms.begin(), other.first_ms.end());
}

nlohmann::json ViewerFigures::json(double seconds) const {
    nlohmann::json figures{{"wishes", wishes},
                           {"late_wishes", late_wishes},
                           {"pages", pages},
                           {"blocks", blocks},
                           {"bytes", bytes},
                           {"bytes_per_second", double(bytes) / seconds},
                           {"errors", errors},
                           {"cold_first_page_ms", toJson(quantilesOf(cold_ms))},
                           {"page_ms", toJson(quantilesOf(page_ms))},
                           {"first_page_ms", toJson(quantilesOf(first_ms))}};
    if (!first_error.empty()) figures["first_error"] = first_error;
    return figures;
}

}  // namespace brickyard
