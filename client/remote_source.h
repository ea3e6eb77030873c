// A dataset behind a server's stream: on a connection of its own, or on one that sources share
// (client/remote_server.h). A network thread receives; the caller takes what came. A connection that is lost
// is made anew, and the newest wish is sent again; the caller only waits longer. docs/protocol.md,
// docs/client.md.
#pragma once

#include <memory>
#include <optional>
#include <string>

#include "client/brick_source.h"
#include "client/stream_address.h"
#include "client/stream_timeouts.h"

namespace brickyard {

class NetworkThread;
class ServerLink;
struct DatasetStream;

class RemoteSource : public BrickSource {
public:
    // Connects and opens the dataset. Errors: kRefused (nobody listens, a wrong token), kNotFound (no such
    // host or dataset), kTooNew (another protocol version), kTimeout, kIo, kCorrupt; each names the address.
    static Result<std::unique_ptr<RemoteSource>> open(const StreamAddress& address, const std::string& token,
                                                      StreamTimeouts timeouts = {},
                                                      const std::optional<StartHint>& start = {},
                                                      std::shared_ptr<NetworkThread> thread = nullptr);
    ~RemoteSource() override;

    std::string name() const override;
    const Manifest& manifest() const override;
    std::shared_ptr<const Manifest> latestManifest() const override;
    Result<bool> waitForChange(SourceDeadline deadline) override;
    // A frame that was converted again while the connection was lost is kNotFound from then on.
    Result<FrameFooter> openFrame(std::uint32_t frame,
                                  SourceDeadline deadline = SourceDeadline::max()) override;
    // At most 65536 pages and 4096 blocks of a wish are sent, from the front; the rest is for the next wish.
    Result<void> wish(PageWish newest) override;
    Result<std::vector<Arrival>> take(SourceDeadline deadline) override;
    bool wishDone() const override;
    SourceCounters counters() const override;

private:
    friend class RemoteServer;
    static Result<std::unique_ptr<RemoteSource>> open(std::shared_ptr<ServerLink> link,
                                                      const std::string& dataset,
                                                      const std::optional<StartHint>& start);
    RemoteSource(std::shared_ptr<ServerLink> link, std::unique_ptr<DatasetStream> stream);

    std::shared_ptr<ServerLink> link_;
    std::unique_ptr<DatasetStream> stream_;  // joined to link_
};

}  // namespace brickyard
