// `brickyard serve`: datasets on one port until SIGINT or SIGTERM.
#include <fmt/format.h>
#include <signal.h>

#include <cassert>
#include <charconv>
#include <cstdio>
#include <filesystem>
#include <fstream>

#include "core/percent_code.h"
#include "server/server.h"
#include "tools/command.h"

namespace brickyard {
namespace {

struct ServeArguments {
    std::vector<std::filesystem::path> datasets;
    std::string listen = "127.0.0.1:8750";
    std::filesystem::path token_file;
    std::string block_cache = "256M";
    double idle_seconds = 120, handshake_seconds = 10;
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

// The first line, without its end.
Result<std::string> readToken(const std::filesystem::path& file) {
    std::ifstream in(file);
    std::string token;
    if (!in || !std::getline(in, token))
        return fail(ErrorCode::kIo,
                    fmt::format("{}: cannot read the token; give a file with one line", file.string()));
    while (!token.empty() && (token.back() == '\r' || token.back() == ' ')) token.pop_back();
    if (token.empty() || token.size() > 4096)
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: a token has 1 to 4096 bytes; write one line", file.string()));
    return token;
}

// The signals that end us, held back from every thread that starts after this, so that sigwait gets them.
sigset_t holdSignals() {
    sigset_t signals;
    sigemptyset(&signals);
    sigaddset(&signals, SIGINT);
    sigaddset(&signals, SIGTERM);
    pthread_sigmask(SIG_BLOCK, &signals, nullptr);
    return signals;
}

Result<void> serve(ServeArguments& arguments) {
    ServerOptions& options = arguments.options;
    [[maybe_unused]] const auto parsed = parseListen(arguments.listen, options);
    assert(parsed);  // checked with the other arguments
    if (!arguments.token_file.empty()) {
        auto token = readToken(arguments.token_file);
        if (!token) return tl::unexpected(token.error());
        options.token = std::move(*token);
    }
    options.block_cache_bytes = parseSize(arguments.block_cache).value_or(options.block_cache_bytes);
    options.idle_timeout = std::chrono::milliseconds(std::int64_t(arguments.idle_seconds * 1000));
    options.handshake_timeout = std::chrono::milliseconds(std::int64_t(arguments.handshake_seconds * 1000));

    auto catalog = Catalog::open(arguments.datasets, options.max_open_frames, options.block_cache_bytes);
    if (!catalog) return tl::unexpected(catalog.error());
    const std::vector<std::string> names = (*catalog)->names();

    const sigset_t signals = holdSignals();
    auto server = Server::start(std::move(*catalog), options);
    if (!server) return tl::unexpected(server.error());

    // Scripts wait for these lines, and read the port from them.
    const std::string host =
        options.host.find(':') == std::string::npos ? options.host : "[" + options.host + "]";
    const std::string place = fmt::format("{}:{}", host, (*server)->port());
    for (const std::string& name : names)
        fmt::print("listening on http://{} (ws://{}/{})\n", place, place, percentEncode(name));
    std::fflush(stdout);

    int received = 0;
    sigwait(&signals, &received);
    (*server)->stop();
    return {};
}

}  // namespace

void addServeCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<ServeArguments>();
    ServerOptions& options = arguments->options;
    CLI::App* command =
        app.add_subcommand("serve", "Serve datasets over HTTP and WebSocket until interrupted");
    command
        ->add_option("DATASET", arguments->datasets,
                     "Dataset folders; a name is its folder's without .bricks")
        ->required();
    command->add_option("--listen", arguments->listen, "HOST:PORT; port 0 picks a free one")
        ->check([](const std::string& text) {
            ServerOptions ignored;
            const auto parsed = parseListen(text, ignored);
            return parsed ? std::string() : parsed.error().message;
        })
        ->capture_default_str();
    command->add_option("--token-file", arguments->token_file,
                        "Ask every client for the token on this file's first line");
    command->add_option("--max-connections", options.max_connections, "Connections at a time")
        ->check(CLI::Range(std::size_t(1), std::size_t(100'000)))
        ->capture_default_str();
    command->add_option("--max-open-frames", options.max_open_frames, "Frame files kept open")
        ->check(CLI::Range(std::size_t(1), std::size_t(100'000)))
        ->capture_default_str();
    command->add_option("--block-cache", arguments->block_cache, "Memory for octree topology")
        ->check([](const std::string& text) {
            const auto parsed = parseSize(text);
            return parsed ? std::string() : parsed.error().message;
        })
        ->capture_default_str();
    command->add_option("--idle-timeout", arguments->idle_seconds, "Seconds until a silent client is dropped")
        ->check(CLI::Range(0.1, 1e6))
        ->capture_default_str();
    command
        ->add_option("--handshake-timeout", arguments->handshake_seconds,
                     "Seconds in which a client must open a dataset")
        ->check(CLI::Range(0.1, 1e6))
        ->capture_default_str();
    command->add_option("--threads", options.threads, "Threads for connections")
        ->check(CLI::Range(std::size_t(1), std::size_t(1024)))
        ->capture_default_str();
    command->add_flag("--verbose", options.verbose, "Log connections on stderr");
    command->callback([arguments, &status] {
        if (auto served = serve(*arguments); !served) status = reportError("serve", served.error());
    });
}

}  // namespace brickyard
