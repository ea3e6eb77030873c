// `brickyard serve`: datasets on one port until SIGINT or SIGTERM.
#include <fmt/format.h>
#include <signal.h>
#include <sys/resource.h>

#include <cassert>
#include <charconv>
#include <cstdio>
#include <filesystem>

#include "core/percent_code.h"
#include "server/server.h"
#include "tools/command.h"

namespace brickyard {
namespace {

struct ServeArguments {
    std::vector<std::filesystem::path> datasets;
    std::string listen = "127.0.0.1:8750";
    std::string block_cache = "256M", queue_memory = "512M", wish_memory = "256M";
    double idle_seconds = 120, handshake_seconds = 10, drain_seconds = 2, rescan_seconds = 1;
    std::string log_format = "text";
    bool verbose = false;
    ServerOptions options;
};

// "127.0.0.1:8750", "[::1]:0".
Result<void> parseListen(const std::string& text, ServerOptions& options) {
    const auto colon = text.rfind(':');
    std::string host = text.substr(0, colon == std::string::npos ? 0 : colon);
    if (host.size() > 2 && host.front() == '[' && host.back() == ']') host = host.substr(1, host.size() - 2);
    const char* begin = text.data() + colon + 1;
    const char* end = text.data() + text.size();
    if (colon == std::string::npos || host.empty() || begin == end ||
        std::from_chars(begin, end, options.port).ptr != end)
        return fail(
            ErrorCode::kInvalid,
            fmt::format("{}: not HOST:PORT; write for example 127.0.0.1:8750, or port 0 for any", text));
    options.host = host;
    return {};
}

// The signals that we act on, held back from every thread that starts after this, so that sigwait gets them.
sigset_t holdSignals() {
    sigset_t signals;
    sigemptyset(&signals);
    sigaddset(&signals, SIGINT);
    sigaddset(&signals, SIGTERM);
    sigaddset(&signals, SIGHUP);
    pthread_sigmask(SIG_BLOCK, &signals, nullptr);
    return signals;
}

std::chrono::milliseconds milliseconds(double seconds) {
    return std::chrono::milliseconds(std::int64_t(seconds * 1000));
}

// A connection and an open frame each take a descriptor; the usual soft limit of 1024 is for old programs.
void raiseDescriptorLimit() {
    rlimit limit{};
    if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
    limit.rlim_cur = limit.rlim_max;
    setrlimit(RLIMIT_NOFILE, &limit);
}

Result<void> serve(ServeArguments& arguments) {
    ServerOptions& options = arguments.options;
    [[maybe_unused]] const auto parsed = parseListen(arguments.listen, options);
    assert(parsed);  // checked with the other arguments
    options.block_cache_bytes = *parseSize(arguments.block_cache);
    options.queue_bytes = *parseSize(arguments.queue_memory);
    options.wish_bytes = *parseSize(arguments.wish_memory);
    options.idle_timeout = milliseconds(arguments.idle_seconds);
    options.handshake_timeout = milliseconds(arguments.handshake_seconds);
    options.drain_timeout = milliseconds(arguments.drain_seconds);
    options.rescan = milliseconds(arguments.rescan_seconds);
    options.log_format = arguments.log_format == "json" ? LogFormat::kJson : LogFormat::kText;
    if (arguments.verbose) options.log_level = "info";
    if (options.tls_certificate.empty() != options.tls_key.empty())
        return fail(ErrorCode::kInvalid, "--tls-cert and --tls-key belong together; give both");
    raiseDescriptorLimit();

    auto catalog = Catalog::open(arguments.datasets, options.max_open_frames, options.block_cache_bytes);
    if (!catalog) return tl::unexpected(catalog.error());
    const std::vector<std::string> names = (*catalog)->names();
    const char* secure = options.tls_certificate.empty() ? "" : "s";

    const sigset_t signals = holdSignals();
    auto server = Server::start(std::move(*catalog), options);
    if (!server) return tl::unexpected(server.error());

    // Scripts wait for these lines, and read the port from them.
    const std::string host =
        options.host.find(':') == std::string::npos ? options.host : "[" + options.host + "]";
    const std::string place = fmt::format("{}:{}", host, (*server)->port());
    for (const std::string& name : names)
        fmt::print("listening on http{}://{} (ws{}://{}/{})\n", secure, place, secure, place,
                   percentEncode(name));
    if (names.empty()) fmt::print("listening on http{}://{} (no dataset yet)\n", secure, place);
    std::fflush(stdout);

    for (;;) {
        int received = 0;
        sigwait(&signals, &received);
        if (received != SIGHUP) break;
        if (auto reloaded = (*server)->reload(); !reloaded)
            fmt::print(stderr, "brickyard serve: all stays as it was: {}\n", reloaded.error().message);
    }
    (*server)->stop();
    return {};
}

}  // namespace

void addServeCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<ServeArguments>();
    ServerOptions& options = arguments->options;
    CLI::App* command =
        app.add_subcommand("serve", "Serve datasets over HTTP and WebSocket until interrupted");
    const auto isSize = [](const std::string& text) {
        const auto parsed = parseSize(text);
        return parsed ? std::string() : parsed.error().message;
    };
    const auto seconds = [&](const char* name, double& value, const char* help) {
        command->add_option(name, value, help)->check(CLI::Range(0.01, 1e6))->capture_default_str();
    };
    const auto count = [&](const char* name, std::size_t& value, std::size_t least, const char* help) {
        command->add_option(name, value, help)
            ->check(CLI::Range(least, std::size_t(1'000'000)))
            ->capture_default_str();
    };
    const auto size = [&](const char* name, std::string& value, const char* help) {
        command->add_option(name, value, help)->check(isSize)->capture_default_str();
    };

    command
        ->add_option(
            "DATASET", arguments->datasets,
            "Dataset folders, or folders of them (*.bricks), which are looked at for new ones; a name is its "
            "folder's without .bricks")
        ->required();
    command->add_option("--listen", arguments->listen, "HOST:PORT; port 0 picks a free one")
        ->check([](const std::string& text) {
            ServerOptions ignored;
            const auto parsed = parseListen(text, ignored);
            return parsed ? std::string() : parsed.error().message;
        })
        ->capture_default_str();

    command->add_option("--tls-cert", options.tls_certificate,
                        "Encrypt: certificate chain in PEM; SIGHUP reads it again");
    command->add_option("--tls-key", options.tls_key, "Its private key in PEM");
    command->add_option(
        "--token-file", options.token_file,
        "Ask every client for a token of this file: a line each, TOKEN [DATASET...] (all datasets where "
        "none is named); SIGHUP reads it again");
    command->add_option("--allow-origin", options.allowed_origins,
                        "Origin of web pages that may open the stream beside the server's own, e.g. "
                        "https://viewer.example; * for any");

    count("--max-connections", options.max_connections, 1, "Connections at a time");
    count("--max-connections-per-address", options.max_connections_per_address, 0,
          "Of them from one address; 0: no limit of its own");
    count("--max-open-frames", options.max_open_frames, 1, "Frame files kept open");
    size("--block-cache", arguments->block_cache, "Memory for octree topology");
    size("--queue-memory", arguments->queue_memory,
         "Memory for what is on its way to all clients; a client has at most 128 KiB of it, or one message");
    size("--wish-memory", arguments->wish_memory, "Memory for the lists of pages that all clients wish for");
    seconds("--idle-timeout", arguments->idle_seconds,
            "Seconds until a client that is silent or does not read is dropped");
    seconds("--handshake-timeout", arguments->handshake_seconds,
            "Seconds in which a request must be whole, and a stream open a dataset");
    seconds("--drain-timeout", arguments->drain_seconds, "Seconds for goodbyes when the server stops");
    seconds("--rescan", arguments->rescan_seconds, "Seconds between two looks for new frames and datasets");
    count("--threads", options.threads, 1, "Threads for connections");
    count("--disk-threads", options.disk_threads, 1, "Threads for what may wait for the disk");

    command->add_option("--log-level", options.log_level, "What is logged on stderr")
        ->check(CLI::IsMember({"critical", "err", "warn", "info", "debug"}))
        ->capture_default_str();
    command->add_option("--log-format", arguments->log_format, "text, or json: an object a line")
        ->check(CLI::IsMember({"text", "json"}))
        ->capture_default_str();
    command->add_flag("--verbose", arguments->verbose, "The same as --log-level info");
    command->callback([arguments, &status] {
        if (auto served = serve(*arguments); !served) status = reportError("serve", served.error());
    });
}

}  // namespace brickyard
