// A dataset behind a server's stream. A thread of its own receives; the caller takes what came.
// docs/protocol.md.
#pragma once

#include <memory>
#include <string>

#include "client/brick_source.h"
#include "client/stream_address.h"
#include "client/stream_connection.h"

namespace brickyard {

class RemoteSource : public BrickSource {
public:
    // Connects and opens the dataset. Errors: kRefused (nobody listens, a wrong token), kNotFound (no such
    // host or dataset), kTooNew (another protocol version), kTimeout, kIo, kCorrupt; each names the address.
    static Result<std::unique_ptr<RemoteSource>> open(const StreamAddress& address, const std::string& token,
                                                      StreamTimeouts timeouts = {});
    ~RemoteSource() override;

    const Manifest& manifest() const override;
    Result<FrameFooter> openFrame(std::uint32_t frame) override;
    // At most 65536 pages and 4096 blocks of a wish are sent, from the front; the rest is for the next wish.
    Result<void> wish(PageWish newest) override;
    Result<std::vector<Arrival>> take(std::chrono::steady_clock::time_point deadline) override;
    bool wishDone() const override;
    SourceCounters counters() const override;

private:
    struct State;
    explicit RemoteSource(std::unique_ptr<State> state);
    std::unique_ptr<State> state_;
};

}  // namespace brickyard
