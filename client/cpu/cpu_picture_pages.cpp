// The pages of a picture: what is asked for, and in which order.

#include "client/cpu/cpu_picture.h"
#include "client/cpu/page_order.h"

namespace brickyard {

namespace {

using Clock = std::chrono::steady_clock;

// With limits: a batch is a share of what came before, so that the order stays current and round trips stay
// few.
constexpr std::uint64_t kLeastBatchBytes = 16u << 10, kBatchShare = 6;
// At most this much, or as much as came before, is asked for to fill a network that is far.
constexpr std::uint64_t kMostToFillBytes = 64u << 10;

}  // namespace

// Sends the wants of the last pass and takes in what comes.
Result<bool> CpuPicture::stream() {
    const std::uint64_t streamed = source_.counters().bytes_streamed;
    const std::uint64_t allowed =
        request_.max_stream_bytes > streamed ? request_.max_stream_bytes - streamed : 0;
    const PageWish wish = stream_.wishFor(wants_, allowed, over_budget_);
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
        asked.failed = [&](const WantedPage& page) { return stream_.failed().contains(page); };
        asked.batch_bytes = std::max<std::uint64_t>(kLeastBatchBytes, streamed / kBatchShare);
        // Where time counts and bytes do not, no smaller batch than a far network carries in a round trip;
        // but the order of a large one is soon out of date.
        if (request_.max_stream_bytes == UINT64_MAX)
            asked.batch_bytes = std::max(
                asked.batch_bytes, std::min(stream_.inFlightBytes(), std::max(kMostToFillBytes, streamed)));
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
