#include "tools/bench/stale_pages.h"

#include "core/wish_walk.h"
#include "tools/bench/greedy_client.h"

namespace brickyard {
namespace {

using Clock = RawStream::Clock;

constexpr std::chrono::milliseconds kLater{50};
constexpr std::chrono::seconds kPatience{30};
constexpr std::size_t kNewPages = 16;

std::uint64_t epochOf(const StreamHeader& header) {
    return header.has_page()         ? header.page().epoch()
           : header.has_block_page() ? header.block_page().epoch()
                                     : 0;
}

std::uint64_t excess(std::uint64_t bytes, std::uint64_t held) { return bytes - std::min(bytes, held); }

}  // namespace

Result<StalePages> measureStalePages(std::uint16_t port, const std::string& dataset,
                                     const SubjectFrame& frame, const RawStreamOptions& how,
                                     double bytes_per_second, bool through_proxy) {
    Result<RawStream> stream = RawStream::open(port, dataset, how);
    if (!stream) return tl::unexpected(stream.error());
    EveryPage every = everyPage(frame);
    PageWish old_wish, new_wish;
    // The finest pages stand last, and have not come when they are asked for.
    const std::size_t kept = every.pages.size() - std::min(kNewPages, every.pages.size() / 2);
    new_wish.pages.assign(every.pages.begin() + std::ptrdiff_t(kept), every.pages.end());
    old_wish.pages.assign(every.pages.begin(), every.pages.begin() + std::ptrdiff_t(kept));
    old_wish.credit_bytes = new_wish.credit_bytes = kMaxWishBytes;

    StreamHeader open_frame;
    open_frame.mutable_open_frame()->set_dataset_id(1);
    open_frame.mutable_open_frame()->set_frame(frame.frame);
    for (const StreamHeader& header : {open_frame, listWish(frame, old_wish, 1)})
        if (Result<void> sent = stream->send(header); !sent) return tl::unexpected(sent.error());

    // Until the sockets are full, but not to the end of a small frame.
    const std::uint64_t before = std::min(std::uint64_t(bytes_per_second), every.bytes / 4);
    const Clock::time_point patience = Clock::now() + kPatience;
    for (std::uint64_t bytes = 0; bytes < before;) {
        const auto message = stream->receive(patience);
        if (!message) return tl::unexpected(message.error());
        if (!*message) return fail(ErrorCode::kTimeout, "a slow client gets nothing");
        bytes += (*message)->wire_bytes;
    }

    StalePages stale;
    const auto held = [&] { return through_proxy ? 0 : stream->bytesOnTheWay(); };
    stale.held_bytes = held();
    const Clock::time_point sent = Clock::now();
    if (Result<void> done = stream->send(listWish(frame, new_wish, 2)); !done)
        return tl::unexpected(done.error());
    std::uint64_t old_by_then = 0;
    bool looked = false;
    for (;;) {
        const auto message = stream->receive(looked ? sent + kPatience : sent + kLater);
        if (!message) return tl::unexpected(message.error());
        if (!looked && Clock::now() >= sent + kLater) {
            looked = true;
            stale.held_later_bytes = held();
            old_by_then = stale.old_bytes;
            // What was just taken out was on its way a moment ago.
            if (*message) stale.held_later_bytes += (*message)->wire_bytes;
        }
        if (!*message) {
            if (Clock::now() >= sent + kPatience)
                return fail(ErrorCode::kTimeout, "no page of a new wish came");
            continue;
        }
        const std::uint64_t epoch = epochOf((*message)->header);
        if (epoch == 1) stale.old_bytes += (*message)->wire_bytes;
        if (epoch == 2) break;
    }
    stale.first_new_ms = std::chrono::duration<double, std::milli>(Clock::now() - sent).count();
    if (!through_proxy) {
        stale.beyond_held = excess(stale.old_bytes, stale.held_bytes);
        if (looked) stale.beyond_held_later = excess(stale.old_bytes - old_by_then, stale.held_later_bytes);
    }
    return stale;
}

}  // namespace brickyard
