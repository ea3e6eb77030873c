// A network on loopback: a TCP proxy that adds delay, a bandwidth and faults between a client and a server,
// so that both can be measured and tested as if they were far apart.
//
// The model of one direction of a connection: bytes queue for a link that sends `bytes_per_second`, and
// arrive `delay` (and up to `jitter`) after the link has sent them, in order. TCP's own handshake cannot be
// held back from outside, so by default the first bytes of a client wait a round trip, as connecting would
// have. There is no loss and no congestion control: a real far connection starts slower.
//
// A thread of its own carries all connections. Any thread may call the members.
#pragma once

#include <chrono>
#include <cstdint>
#include <limits>
#include <memory>

#include "core/result.h"

namespace brickyard {

// One way through the proxy, for each connection by itself.
struct DelayProxyLink {
    static constexpr std::uint64_t kNever = std::numeric_limits<std::uint64_t>::max();

    std::chrono::microseconds delay{0};   // one way
    std::chrono::microseconds jitter{0};  // what is read at one time arrives later by [0, jitter]
    std::uint64_t bytes_per_second =
        0;  // 0: as fast as it goes, counted as 10 Gbit/s where memory is bounded
    // So many bytes may wait for the link beside those that travel; then the sender is not read from, and its
    // own buffers fill. What a router would hold.
    std::uint64_t queue_bytes = std::uint64_t(1) << 20;
    // Once exactly so many bytes have been handed over, the connection is closed on both sides.
    std::uint64_t cut_after_bytes = kNever;
    // Once exactly so many bytes have been handed over, nothing more is; both ends stay open.
    std::uint64_t stall_after_bytes = kNever;
};

struct DelayProxyOptions {
    std::uint16_t server_port = 0;  // on 127.0.0.1
    std::uint16_t listen_port = 0;  // on 127.0.0.1; 0 picks a free one
    DelayProxyLink to_server = {}, to_client = {};
    bool connecting_takes_a_round_trip = true;
    std::uint64_t seed = 1;  // of the jitter
};

class DelayProxy {
public:
    struct Counts {
        std::uint64_t connections = 0;                           // accepted since the start
        std::uint64_t open = 0;                                  // now
        std::uint64_t bytes_to_server = 0, bytes_to_client = 0;  // handed over
        std::uint64_t most_held_bytes = 0;  // the most that one direction of one connection held in memory
    };

    // Listens when this returns. Errors: kIo (the port cannot be had).
    static Result<std::unique_ptr<DelayProxy>> start(const DelayProxyOptions& options);
    // Closes every connection.
    ~DelayProxy();
    DelayProxy(const DelayProxy&) = delete;
    DelayProxy& operator=(const DelayProxy&) = delete;

    std::uint16_t port() const;
    Counts counts() const;

    // While stalled nothing is handed over in either direction, on any connection, and nobody is told.
    void stall(bool stalled);
    // Closes every connection that is open now.
    void cut();
    // Leaves every connection that is open now half-open, as a cable that is pulled out does: both ends may
    // go on sending, nothing arrives, and neither hears that the other has closed. Later connections are
    // sound.
    void vanish();

private:
    struct State;
    explicit DelayProxy(std::unique_ptr<State> state);
    std::unique_ptr<State> state_;
};

}  // namespace brickyard
