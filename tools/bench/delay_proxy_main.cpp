// `delay-proxy`: a far network on loopback until interrupted. `tools/build release delay_proxy` makes it.
#include <fmt/format.h>
#include <signal.h>

#include <CLI/CLI.hpp>
#include <cstdio>

#include "tools/bench/delay_proxy.h"

namespace {

using brickyard::DelayProxy;
using brickyard::DelayProxyOptions;

int runProxy(const DelayProxyOptions& options) {
    // Before the proxy's thread starts, which inherits the mask.
    sigset_t signals;
    sigemptyset(&signals);
    sigaddset(&signals, SIGINT);
    sigaddset(&signals, SIGTERM);
    pthread_sigmask(SIG_BLOCK, &signals, nullptr);

    const auto proxy = DelayProxy::start(options);
    if (!proxy) {
        fmt::print(stderr, "delay-proxy: {}\n", proxy.error().message);
        return 1;
    }
    fmt::print("listening on 127.0.0.1:{}, for 127.0.0.1:{}\n", (*proxy)->port(), options.server_port);
    std::fflush(stdout);
    int received = 0;
    sigwait(&signals, &received);
    const DelayProxy::Counts counts = (*proxy)->counts();
    fmt::print("{} connections, {} bytes to the server, {} bytes to clients\n", counts.connections,
               counts.bytes_to_server, counts.bytes_to_client);
    return 0;
}

}  // namespace

int main(int argc, char** argv) {
    CLI::App app(
        "A far network on loopback: a TCP proxy with delay and a limited bandwidth, until interrupted");
    DelayProxyOptions options;
    double delay_ms = 25, jitter_ms = 0;
    std::uint64_t rate = 0;
    bool quick = false;
    app.add_option("PORT", options.server_port, "Port of the server, on 127.0.0.1")->required();
    app.add_option("--listen", options.listen_port, "Port to listen on, on 127.0.0.1; 0 picks a free one")
        ->capture_default_str();
    app.add_option("--delay", delay_ms, "Milliseconds one way")
        ->check(CLI::Range(0.0, 60e3))
        ->capture_default_str();
    app.add_option("--jitter", jitter_ms, "Milliseconds that a piece may be late; order is kept")
        ->check(CLI::Range(0.0, 60e3))
        ->capture_default_str();
    app.add_option("--rate", rate, "Bytes a second each way, for example 6M; 0: no limit")
        ->transform(CLI::AsSizeValue(/*kb_is_1000=*/false))
        ->capture_default_str();
    app.add_flag("--quick-connect", quick, "Connecting takes no time; otherwise a round trip");
    CLI11_PARSE(app, argc, argv);
    for (auto* link : {&options.to_server, &options.to_client}) {
        link->delay = std::chrono::microseconds(std::int64_t(delay_ms * 1000));
        link->jitter = std::chrono::microseconds(std::int64_t(jitter_ms * 1000));
        link->bytes_per_second = rate;
    }
    options.connecting_takes_a_round_trip = !quick;
    return runProxy(options);
}
