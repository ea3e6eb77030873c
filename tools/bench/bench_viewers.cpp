// `brickyard bench viewers`: a thousand viewers of one server, and ten thousand connections that do nothing.
#include <fmt/format.h>
#include <sys/resource.h>

#include <algorithm>
#include <thread>

#include "tools/bench/benchmark.h"
#include "tools/bench/raw_stream.h"
#include "tools/bench/server_process.h"
#include "tools/bench/text_table.h"
#include "tools/bench/viewer_crowd.h"

namespace brickyard {
namespace {

using Clock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

// Descriptors beside those of connections: files, pipes, the server's own.
constexpr std::uint64_t kOtherDescriptors = 200;
// So many idle connections come from one address: well below the ports that it has.
constexpr std::size_t kPerAddress = 20'000;
constexpr std::uint64_t kWantedIdleBytes = 1'000'000'000;
// Most memory at the end over that at half time: what counts as flat.
constexpr double kFlat = 1.05;
// Viewers beside the idle connections, and how long.
constexpr std::size_t kBeside = 10;
constexpr double kMostBesideSeconds = 10;

void sleepFor(double seconds) { std::this_thread::sleep_for(Seconds(seconds)); }

std::vector<std::string> latencyRow(std::string name, const Quantiles& q) {
    return {std::move(name), fmt::format("{}", q.count), cell(q.p50), cell(q.p99), cell(q.most)};
}

double ownCpuSeconds() {
    rusage used{};
    ::getrusage(RUSAGE_SELF, &used);
    const auto seconds = [](const timeval& time) {
        return double(time.tv_sec) + 1e-6 * double(time.tv_usec);
    };
    return seconds(used.ru_utime) + seconds(used.ru_stime);
}

class ViewersBench {
public:
    explicit ViewersBench(const BenchOptions& options) : options_(options) {
        settings_.credit_bytes = std::uint64_t(options.wish_kib) << 10;
    }

    Result<nlohmann::json> run() {
        if (auto raised = raiseDescriptorLimit(kOtherDescriptors + options_.idle + options_.viewers); !raised)
            return tl::unexpected(raised.error());
        auto subject = convertServed(options_);
        if (!subject) return tl::unexpected(subject.error());
        subject_ = std::move(*subject);
        auto paths = makeViewerPaths(subject_);
        if (!paths) return tl::unexpected(paths.error());
        paths_ = std::move(*paths);
        // Idle connections say nothing, not even pongs: they are meant to stay nevertheless.
        auto server = ServerProcess::start(
            subject_.folder, options_.scratch,
            {"--max-connections", std::to_string(options_.idle + options_.viewers + kOtherDescriptors),
             "--idle-timeout", "3600", "--handshake-timeout", "60"});
        if (!server) return tl::unexpected(server.error());
        server_ = std::move(*server);

        nlohmann::json json{{"cache", subject_.cache}, {"payload_bytes", subject_.payload_bytes}};
        for (auto [name, part] :
             {std::pair("streaming", &ViewersBench::stream), {"idle", &ViewersBench::idle}}) {
            Result<nlohmann::json> figures = (this->*part)();
            if (!figures) return figures;
            json[name] = std::move(*figures);
        }
        return json;
    }

private:
    // A crowd for `seconds`, with the server's memory at a quarter, at half and at the end.
    struct Show {
        ViewerFigures figures;
        ServerUsage before, quarter, half, end;
        double seconds = 0;
        double own_cpu_seconds = 0;  // of all viewers, and of the bench itself
    };
    Result<Show> show(std::size_t viewers, double seconds) {
        ViewerCrowd crowd(server_->address(), subject_, paths_, viewers, settings_);
        Show show;
        Result<ServerUsage> usage = server_->usage();
        if (!usage) return tl::unexpected(usage.error());
        show.before = *usage;
        crowd.begin();
        const Clock::time_point began = Clock::now();
        const double own_cpu = ownCpuSeconds();
        for (auto [part, to] : {std::pair(0.25, &Show::quarter), {0.25, &Show::half}, {0.5, &Show::end}}) {
            sleepFor(part * seconds);
            usage = server_->usage();
            if (!usage) return tl::unexpected(usage.error());
            show.*to = *usage;
        }
        show.seconds = Seconds(Clock::now() - began).count();
        show.own_cpu_seconds = ownCpuSeconds() - own_cpu;
        show.figures = crowd.end();
        return show;
    }

    Result<nlohmann::json> stream() {
        options_.progress(fmt::format("{} viewers", options_.viewers));
        Result<Show> done = show(options_.viewers, options_.seconds);
        if (!done) return tl::unexpected(done.error());
        const Show& s = *done;
        const double cores = (s.end.cpu_seconds - s.before.cpu_seconds) / s.seconds;
        const double growth = double(s.end.resident_bytes) / double(s.half.resident_bytes);
        options_.print(
            fmt::format("{} viewers of {} for {:.0f} s, a thread and a cache of {} KiB each, a wish of "
                        "{} KiB every {} ms:",
                        options_.viewers, subject_.cache, s.seconds, settings_.cache_bytes >> 10,
                        settings_.credit_bytes >> 10, settings_.pace.count()));
        printFigures(s);
        options_.print(fmt::format(
            "  server's resident MB at 1/4, 1/2, end: {:.1f}, {:.1f}, {:.1f} ({}flat: end over half {:.3f}); "
            "{:.0f} viewers for each of its cores",
            double(s.quarter.resident_bytes) * 1e-6, double(s.half.resident_bytes) * 1e-6,
            double(s.end.resident_bytes) * 1e-6, growth <= kFlat ? "" : "NOT ", growth,
            double(options_.viewers) / cores));
        nlohmann::json json = s.figures.json(s.seconds);
        json["viewers"] = options_.viewers;
        json["wish_kib"] = options_.wish_kib;
        json["viewers_cpu_seconds"] = s.own_cpu_seconds;
        json["seconds"] = s.seconds;
        json["server"] = usageJson(s.before, s.end, s.seconds);
        json["resident_bytes_at_quarters"] = {s.quarter.resident_bytes, s.half.resident_bytes,
                                              s.end.resident_bytes};
        json["end_over_half"] = growth;
        json["memory_is_flat"] = growth <= kFlat;
        json["viewers_per_core"] = double(options_.viewers) / cores;
        return json;
    }

    void printFigures(const Show& s) {
        TextTable table({"ms since the wish", "count", "p50", "p99", "max"});
        table.add(latencyRow("first page of the first wish", quantilesOf(s.figures.cold_ms)));
        table.add(latencyRow("first page", quantilesOf(s.figures.first_ms)));
        table.add(latencyRow("every page", quantilesOf(s.figures.page_ms)));
        options_.print(table.text());
        options_.print(
            fmt::format("  {} wishes ({} late), {} pages, {} tree blocks, {:.1f} MB/s, {} errors{}",
                        s.figures.wishes, s.figures.late_wishes, s.figures.pages, s.figures.blocks,
                        double(s.figures.bytes) * 1e-6 / s.seconds, s.figures.errors,
                        s.figures.first_error.empty() ? "" : ": " + s.figures.first_error));
        options_.print("  " + usageText(s.before, s.end, s.seconds));
        options_.print(fmt::format("  viewers: {:.2f} CPU s ({:.2f} cores)", s.own_cpu_seconds,
                                   s.own_cpu_seconds / s.seconds));
    }

    Result<nlohmann::json> idle() {
        const double seconds = std::min(kMostBesideSeconds, options_.seconds);
        options_.progress("viewers alone");
        const Result<Show> alone = show(std::min(kBeside, options_.viewers), seconds);
        if (!alone) return tl::unexpected(alone.error());

        std::vector<RawStream> crowd;
        crowd.reserve(options_.idle);
        const Clock::time_point began = Clock::now();
        for (std::size_t i = 0; i < options_.idle; ++i) {
            if (i % 500 == 0) options_.progress(fmt::format("{} idle connections", i));
            RawStreamOptions how;
            how.source = std::uint8_t(1 + i / kPerAddress);
            Result<RawStream> stream = RawStream::open(server_->port(), server_->address().dataset, how);
            if (!stream)
                return fail(stream.error().code,
                            fmt::format("idle connection {}: {}", i, stream.error().message));
            crowd.push_back(std::move(*stream));
        }
        const double connecting = Seconds(Clock::now() - began).count();
        const Result<ServerUsage> full = server_->usage();
        if (!full) return tl::unexpected(full.error());
        options_.progress("viewers beside them");
        const Result<Show> beside = show(std::min(kBeside, options_.viewers), seconds);
        if (!beside) return tl::unexpected(beside.error());
        const std::size_t alive = countAlive(crowd);

        const std::uint64_t resident = std::max(full->resident_bytes, beside->end.resident_bytes);
        const double each = (double(full->resident_bytes) - double(alone->end.resident_bytes)) /
                            double(std::max<std::size_t>(1, crowd.size()));
        const bool holds = resident < kWantedIdleBytes;
        options_.print(
            fmt::format("{} idle connections (Hello and Open) made in {:.1f} s, {} alive at the end: the "
                        "server has {:.1f} MB "
                        "resident, {:.1f} KB for each (wanted: below {:.0f} MB in all{})",
                        crowd.size(), connecting, alive, double(resident) * 1e-6, each * 1e-3,
                        double(kWantedIdleBytes) * 1e-6, holds ? "" : ": NOT SO"));
        TextTable table({fmt::format("ms since the wish, of {} viewers", std::min(kBeside, options_.viewers)),
                         "count", "p50", "p99", "max"});
        table.add(latencyRow("first page, alone", quantilesOf(alone->figures.first_ms)));
        table.add(latencyRow("first page, beside the idle", quantilesOf(beside->figures.first_ms)));
        table.add(latencyRow("every page, alone", quantilesOf(alone->figures.page_ms)));
        table.add(latencyRow("every page, beside the idle", quantilesOf(beside->figures.page_ms)));
        options_.print(table.text());
        options_.print(fmt::format("  {} errors of the viewers; {}",
                                   alone->figures.errors + beside->figures.errors,
                                   usageText(beside->before, beside->end, beside->seconds)));
        return nlohmann::json{{"connections", crowd.size()},
                              {"alive_at_the_end", alive},
                              {"connect_seconds", connecting},
                              {"resident_bytes", resident},
                              {"resident_bytes_each", each},
                              {"memory_holds", holds},
                              {"viewers_alone", alone->figures.json(alone->seconds)},
                              {"viewers_beside", beside->figures.json(beside->seconds)},
                              {"server", usageJson(beside->before, beside->end, beside->seconds)}};
    }

    // Those that still answer a Ping.
    static std::size_t countAlive(std::vector<RawStream>& crowd) {
        StreamHeader ping;
        ping.mutable_ping()->set_number(1);
        std::vector<bool> sent;
        for (RawStream& stream : crowd) sent.push_back(bool(stream.send(ping)));
        std::size_t alive = 0;
        const Clock::time_point deadline = Clock::now() + std::chrono::seconds(30);
        for (std::size_t i = 0; i < crowd.size(); ++i) {
            if (!sent[i]) continue;
            const auto answer = crowd[i].receive(deadline);
            alive += answer && *answer && (*answer)->header.has_pong();
        }
        return alive;
    }

    const BenchOptions& options_;
    ServedSubject subject_;
    std::vector<ViewerPath> paths_;
    std::unique_ptr<ServerProcess> server_;
    ViewerSettings settings_;
};

}  // namespace

Result<nlohmann::json> benchViewers(const BenchOptions& options) { return ViewersBench(options).run(); }

}  // namespace brickyard
