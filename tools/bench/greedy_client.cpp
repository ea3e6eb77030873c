#include "tools/bench/greedy_client.h"

#include "client/wish_message.h"
#include "core/wish_walk.h"

namespace brickyard {

StreamHeader listWish(const SubjectFrame& frame, const PageWish& list, std::uint64_t epoch) {
    StreamHeader header;
    Wish& wish = *header.mutable_wish();
    wish = wishMessage(list);
    wish.set_epoch(epoch);
    wish.set_dataset_id(1);
    wish.set_frame(frame.frame);
    wish.set_credit_bytes(list.credit_bytes);
    return header;
}

Result<std::unique_ptr<GreedyClient>> GreedyClient::start(std::uint16_t port, const std::string& dataset,
                                                          const ServedSubject& subject,
                                                          const ViewerPath& path, Greed greed) {
    Result<RawStream> stream = RawStream::open(port, dataset);
    if (!stream) return tl::unexpected(stream.error());
    return std::unique_ptr<GreedyClient>(
        new GreedyClient(std::move(*stream), subject.frames[path.frame], path, greed));
}

GreedyClient::GreedyClient(RawStream stream, const SubjectFrame& frame, const ViewerPath& path, Greed greed)
    : stream_(std::move(stream)), greed_(greed) {
    PageWish every, seen;
    every.pages = everyPage(frame).pages;
    seen.views.push_back({path.stations.front().camera,
                          kViewerWidth,
                          kViewerHeight,
                          {frame.channel},
                          /*pixels_per_voxel=*/0.1f});
    every.credit_bytes = seen.credit_bytes = kMaxWishBytes;
    every_ = listWish(frame, every, 0);
    seen_ = listWish(frame, seen, 0);

    StreamHeader open_frame;
    open_frame.mutable_open_frame()->set_dataset_id(1);
    open_frame.mutable_open_frame()->set_frame(frame.frame);
    if (!stream_.send(open_frame) || !wish()) failed_ = true;
    reader_ = std::jthread([this] { read(); });
    if (greed_ == Greed::kFlood) sender_ = std::jthread([this] { flood(); });
}

GreedyClient::~GreedyClient() {
    over_ = true;
    stream_.shutdown();
}

bool GreedyClient::wish() {
    StreamHeader& header = greed_ == Greed::kFlood && epoch_ % 2 == 1 ? seen_ : every_;
    header.mutable_wish()->set_epoch(++epoch_);
    ++wishes_;
    return bool(stream_.send(header));
}

void GreedyClient::flood() {
    while (!over_)
        if (!wish()) {
            if (!over_) failed_ = true;
            return;
        }
}

void GreedyClient::read() {
    for (;;) {
        const auto message = stream_.receive(RawStream::Clock::now() + std::chrono::hours(1));
        if (over_) return;
        if (!message || !*message || (*message)->header.has_failed()) {
            failed_ = true;
            return;
        }
        bytes_ += (*message)->wire_bytes;
        if (greed_ == Greed::kEverything && (*message)->header.has_wish_done() && !wish()) {
            if (!over_) failed_ = true;
            return;
        }
    }
}

}  // namespace brickyard
