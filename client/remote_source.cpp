#include "client/remote_source.h"

#include <fmt/format.h>

#include <algorithm>

#include "client/server_link.h"
#include "core/camera.h"

namespace brickyard {
namespace {

constexpr std::size_t kChunkPages = 64;
constexpr std::size_t kChunkBytes = 1u << 20;

}  // namespace

RemoteSource::RemoteSource(std::shared_ptr<ServerLink> link, std::unique_ptr<DatasetStream> stream)
    : link_(std::move(link)), stream_(std::move(stream)) {}

RemoteSource::~RemoteSource() {
    const std::lock_guard lock(link_->mutex);
    link_->leave(*stream_);
}

Result<std::unique_ptr<RemoteSource>> RemoteSource::open(const StreamAddress& address,
                                                         const std::string& token, StreamTimeouts timeouts,
                                                         const std::optional<StartHint>& start,
                                                         std::shared_ptr<NetworkThread> thread) {
    return open(std::make_shared<ServerLink>(address, token, timeouts, std::move(thread), /*alone=*/true),
                address.dataset, start);
}

Result<std::unique_ptr<RemoteSource>> RemoteSource::open(std::shared_ptr<ServerLink> link,
                                                         const std::string& dataset,
                                                         const std::optional<StartHint>& start) {
    auto owned = std::make_unique<DatasetStream>(dataset, start);
    DatasetStream& stream = *owned;
    {
        const std::lock_guard lock(link->mutex);
        if (Result<void> joined = link->join(stream); !joined) return tl::unexpected(joined.error());
    }
    std::unique_ptr<RemoteSource> source(new RemoteSource(link, std::move(owned)));
    {
        std::unique_lock lock(link->mutex);
        ++stream.counters.round_trips;
        link->wait(lock, stream, SourceDeadline::max(), /*owed=*/true, "dataset " + dataset,
                   [&] { return stream.first_manifest != nullptr; });
        if (const Error* error = link->failure(stream); error && !stream.first_manifest) {
            Error copy = *error;
            lock.unlock();
            return tl::unexpected(std::move(copy));
        }
    }
    return source;
}

std::string RemoteSource::name() const { return link_->urlOf(*stream_); }

const Manifest& RemoteSource::manifest() const { return *stream_->first_manifest; }

std::shared_ptr<const Manifest> RemoteSource::latestManifest() const {
    const std::lock_guard lock(link_->mutex);
    return stream_->manifest;
}

Result<bool> RemoteSource::waitForChange(SourceDeadline deadline) {
    std::unique_lock lock(link_->mutex);
    DatasetStream& stream = *stream_;
    link_->wait(lock, stream, deadline, /*owed=*/false, "news", [&] { return stream.news; });
    if (std::exchange(stream.news, false)) return true;
    if (const Error* error = link_->failure(stream)) return tl::unexpected(*error);
    return false;
}

Result<FrameFooter> RemoteSource::openFrame(std::uint32_t frame, SourceDeadline deadline) {
    std::unique_lock lock(link_->mutex);
    DatasetStream& stream = *stream_;
    if (const Error* error = link_->failure(stream)) return tl::unexpected(*error);
    // The hint may have asked already.
    std::optional<FrameOpening>& opening = stream.opening;
    std::optional<std::uint32_t> early;
    if (opening && opening->early) {
        early = opening->frame;
        if (!early && stream.manifest->frames_size() > 0) early = stream.manifest->frames(0).frame();
    }
    if (early != frame) {
        ++stream.counters.round_trips;
        opening.emplace();
        opening->frame = frame;
        opening->number = ++stream.openings;
        link_->askFrame(stream);
    }
    opening->early = false;
    const bool in_time = link_->wait(lock, stream, deadline, /*owed=*/true, fmt::format("frame {}", frame),
                                     [&] { return opening->answer.has_value(); });
    if (!opening->answer) {
        opening.reset();
        if (!in_time)
            return fail(ErrorCode::kTimeout,
                        fmt::format("{}: waited for frame {}: no answer by the deadline; allow more time",
                                    link_->urlOf(stream), frame));
        return tl::unexpected(*link_->failure(stream));
    }
    Result<FrameFooter> footer = std::move(*opening->answer);
    opening.reset();
    return footer;
}

Result<void> RemoteSource::wish(PageWish newest) {
    // Refused here as a local source refuses it: the server would end the connection.
    for (const CameraView& view : newest.views)
        if (auto camera = PinholeCamera::create(view.camera, view.width, view.height); !camera)
            return tl::unexpected(camera.error());
    Wish wanted = wishMessage(newest);

    const std::lock_guard lock(link_->mutex);
    DatasetStream& stream = *stream_;
    if (const Error* error = link_->failure(stream)) return tl::unexpected(*error);
    if (!stream.frame)
        return fail(
            ErrorCode::kInvalid,
            fmt::format("{}: pages are wished before a frame is open; open one first", link_->urlOf(stream)));
    // The wish that went with the greeting is this one: it is under way, or done.
    if (stream.early_seen && newest.pages.empty() && newest.views.size() == 1 &&
        sameView(*stream.early_seen, newest.views.front()) && newest.credit_bytes == stream.last_credit) {
        stream.early_view.reset();
        stream.early_seen.reset();
        stream.wanted = std::move(wanted);
        return {};
    }
    ++stream.counters.round_trips;
    stream.forgetWish();
    stream.wanted = std::move(wanted);
    stream.done = false;
    // What waits to be taken has its room already.
    stream.credit_granted = stream.credit_left =
        newest.credit_bytes - std::min(newest.credit_bytes, stream.queued_bytes);
    const std::uint64_t sum = newest.credit_bytes + stream.last_credit;
    stream.queue_limit = sum < newest.credit_bytes ? newest.credit_bytes : sum;
    stream.last_credit = newest.credit_bytes;
    link_->sendWish(stream);
    return {};
}

Result<std::vector<Arrival>> RemoteSource::take(SourceDeadline deadline) {
    std::vector<Arrival> chunk;
    std::unique_lock lock(link_->mutex);
    DatasetStream& stream = *stream_;
    link_->wait(lock, stream, deadline, /*owed=*/true, "pages",
                [&] { return !stream.arrivals.empty() || stream.done || stream.wish_failed; });
    std::size_t bytes = 0;
    while (!stream.arrivals.empty() && chunk.size() < kChunkPages && bytes < kChunkBytes) {
        Arrival& next = stream.arrivals.front();
        if (next.bytes) bytes += next.bytes->size();
        chunk.push_back(std::move(next));
        stream.arrivals.pop_front();
    }
    stream.queued_bytes -= bytes;
    link_->resume(stream);
    if (!chunk.empty()) return chunk;
    if (const Error* error = link_->failure(stream); error && !stream.done) return tl::unexpected(*error);
    if (stream.wish_failed) return tl::unexpected(*std::exchange(stream.wish_failed, std::nullopt));
    return chunk;
}

bool RemoteSource::wishDone() const {
    const std::lock_guard lock(link_->mutex);
    return stream_->done && stream_->arrivals.empty();
}

SourceCounters RemoteSource::counters() const {
    const std::lock_guard lock(link_->mutex);
    return stream_->counters;
}

}  // namespace brickyard
