// `brickyard bench fairness`: what viewers notice of a greedy client, and how soon a slow client is done with
// a wish that it has replaced.
#include <fmt/format.h>

#include <optional>
#include <thread>

#include "tools/bench/benchmark.h"
#include "tools/bench/delay_proxy.h"
#include "tools/bench/greedy_client.h"
#include "tools/bench/server_process.h"
#include "tools/bench/stale_pages.h"
#include "tools/bench/text_table.h"
#include "tools/bench/viewer_crowd.h"

namespace brickyard {
namespace {

using Clock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

constexpr double kPartOfSeconds = 1.0 / 6;
constexpr std::chrono::milliseconds kPace{250};
constexpr int kSlowBufferBytes = 64 << 10;
constexpr unsigned kTrials = 10;

// A phase of the viewers, and who is there beside them.
enum class Beside { kNobody, kWorker, kGreedy, kFlood };

struct Phase {
    const char* name;
    const char* what;
    Beside beside;
};

// Alone at both ends: how far those two are apart is the noise.
constexpr Phase kPhases[] = {
    {"alone", "alone", Beside::kNobody},
    {"busy", "beside a thread that only computes", Beside::kWorker},
    {"greedy", "beside one that wishes for everything", Beside::kGreedy},
    {"flood", "beside one that floods wishes", Beside::kFlood},
    {"alone_again", "alone again", Beside::kNobody},
};

struct PhaseFigures {
    ViewerFigures viewers;
    double seconds = 0;
    ServerUsage before, after;
    std::uint64_t greedy_bytes = 0, greedy_wishes = 0;
    bool greedy_failed = false;
};

class FairnessBench {
public:
    explicit FairnessBench(const BenchOptions& options) : options_(options) {
        settings_.pace = kPace;
        settings_.credit_bytes = std::uint64_t(options.wish_kib) << 10;
    }

    Result<nlohmann::json> run() {
        if (auto raised = raiseDescriptorLimit(200 + options_.normal); !raised)
            return tl::unexpected(raised.error());
        auto subject = convertServed(options_);
        if (!subject) return tl::unexpected(subject.error());
        subject_ = std::move(*subject);
        auto paths = makeViewerPaths(subject_);
        if (!paths) return tl::unexpected(paths.error());
        paths_ = std::move(*paths);
        auto server = ServerProcess::start(subject_.folder, options_.scratch,
                                           {"--max-connections", std::to_string(200 + options_.normal)});
        if (!server) return tl::unexpected(server.error());
        server_ = std::move(*server);

        nlohmann::json json{{"cache", subject_.cache}};
        Result<nlohmann::json> shares = runPhases();
        if (!shares) return shares;
        json["shares"] = std::move(*shares);
        Result<nlohmann::json> current = runCurrent();
        if (!current) return current;
        json["current"] = std::move(*current);
        return json;
    }

private:
    Result<PhaseFigures> runPhase(const Phase& phase) {
        options_.progress(phase.what);
        ViewerCrowd crowd(server_->address(), subject_, paths_, options_.normal, settings_);
        PhaseFigures figures;
        std::unique_ptr<GreedyClient> greedy;
        std::jthread worker;
        if (phase.beside == Beside::kWorker)
            worker = std::jthread([](const std::stop_token& stop) {
                for (volatile unsigned spins = 0; !stop.stop_requested();) spins = spins + 1;
            });
        if (phase.beside == Beside::kGreedy || phase.beside == Beside::kFlood) {
            auto started =
                GreedyClient::start(server_->port(), server_->address().dataset, subject_, paths_.back(),
                                    phase.beside == Beside::kFlood ? Greed::kFlood : Greed::kEverything);
            if (!started) return tl::unexpected(started.error());
            greedy = std::move(*started);
        }
        const Result<ServerUsage> before = server_->usage();
        if (!before) return tl::unexpected(before.error());
        figures.before = *before;
        crowd.begin();
        const Clock::time_point began = Clock::now();
        const std::uint64_t bytes = greedy ? greedy->bytes() : 0, wishes = greedy ? greedy->wishes() : 0;
        std::this_thread::sleep_for(Seconds(options_.seconds * kPartOfSeconds));
        figures.seconds = Seconds(Clock::now() - began).count();
        if (greedy) {
            figures.greedy_bytes = greedy->bytes() - bytes;
            figures.greedy_wishes = greedy->wishes() - wishes;
            figures.greedy_failed = greedy->failed();
        }
        const Result<ServerUsage> after = server_->usage();
        if (!after) return tl::unexpected(after.error());
        figures.after = *after;
        figures.viewers = crowd.end();
        return figures;
    }

    Result<nlohmann::json> runPhases() {
        options_.print(fmt::format("{} viewers of {}, {:.1f} s each time, a wish of {} KiB every {} ms:",
                                   options_.normal, subject_.cache, options_.seconds * kPartOfSeconds,
                                   settings_.credit_bytes >> 10, settings_.pace.count()));
        TextTable table({"viewers", "page p50 ms", "p99 ms", "p99/alone", "first p99 ms", "late", "MB/s",
                         "MB/s over alone", "errors", "greedy MB/s", "greedy wishes/s", "server cores"});
        nlohmann::json json;
        std::vector<std::string> servers;
        std::optional<Quantiles> alone;
        double alone_rate = 0;
        for (const Phase& phase : kPhases) {
            const Result<PhaseFigures> done = runPhase(phase);
            if (!done) return tl::unexpected(done.error());
            const PhaseFigures& f = *done;
            const Quantiles pages = quantilesOf(f.viewers.page_ms), first = quantilesOf(f.viewers.first_ms);
            const double rate = double(f.viewers.bytes) * 1e-6 / f.seconds;
            const double greedy = double(f.greedy_bytes) * 1e-6 / f.seconds;
            const double cores = (f.after.cpu_seconds - f.before.cpu_seconds) / f.seconds;
            if (!alone) alone = pages, alone_rate = rate;
            const bool is_greedy = phase.beside == Beside::kGreedy || phase.beside == Beside::kFlood;
            table.add({phase.what, cell(pages.p50), cell(pages.p99), cell(pages.p99 / alone->p99),
                       cell(first.p99), fmt::format("{}", f.viewers.late_wishes), cell(rate),
                       cell(rate / alone_rate), fmt::format("{}", f.viewers.errors),
                       is_greedy ? cell(greedy) + (f.greedy_failed ? " (cut off)" : "") : "-",
                       is_greedy ? cell(double(f.greedy_wishes) / f.seconds) : "-", cell(cores)});
            servers.push_back(fmt::format("  {}: {}", phase.what, usageText(f.before, f.after, f.seconds)));
            nlohmann::json figure = f.viewers.json(f.seconds);
            figure["p50_over_alone"] = pages.p50 / alone->p50;
            figure["p99_over_alone"] = pages.p99 / alone->p99;
            figure["throughput_over_alone"] = rate / alone_rate;
            if (is_greedy) {
                figure["greedy_bytes_per_second"] = greedy * 1e6;
                figure["greedy_wishes_per_second"] = double(f.greedy_wishes) / f.seconds;
                figure["greedy_was_cut_off"] = f.greedy_failed;
            }
            figure["server"] = usageJson(f.before, f.after, f.seconds);
            json[phase.name] = std::move(figure);
        }
        options_.print(table.text());
        for (const std::string& line : servers) options_.print(line);
        return json;
    }

    // One line of the table: trials of a client that reads directly, or through a network.
    Result<nlohmann::json> trial(TextTable& table, const char* name, std::uint16_t port,
                                 const RawStreamOptions& how, bool through_proxy) {
        std::vector<float> old_kb, beyond_kb, beyond_later_kb, first_ms;
        for (unsigned i = 0; i < kTrials; ++i) {
            options_.progress(fmt::format("{}: {} of {}", name, i + 1, kTrials));
            const Result<StalePages> stale =
                measureStalePages(port, server_->address().dataset, subject_.frames.back(), how,
                                  options_.mbit * 1e6 / 8, through_proxy);
            if (!stale) return tl::unexpected(stale.error());
            old_kb.push_back(float(double(stale->old_bytes) * 1e-3));
            beyond_kb.push_back(float(double(stale->beyond_held) * 1e-3));
            beyond_later_kb.push_back(float(double(stale->beyond_held_later) * 1e-3));
            first_ms.push_back(float(stale->first_new_ms));
        }
        const Quantiles old = quantilesOf(old_kb), beyond = quantilesOf(beyond_kb),
                        later = quantilesOf(beyond_later_kb), first = quantilesOf(first_ms);
        const auto seen = [&](double value) { return through_proxy ? std::string("-") : cell(value); };
        table.add({name, cell(old.p50), cell(old.most), seen(beyond.most), seen(later.most), cell(first.p50),
                   cell(first.most)});
        nlohmann::json json{{"old_kb", toJson(old)}, {"first_new_ms", toJson(first)}};
        if (!through_proxy) {
            json["beyond_sockets_kb"] = toJson(beyond);
            json["beyond_sockets_after_50_ms_kb"] = toJson(later);
        }
        return json;
    }

    Result<nlohmann::json> runCurrent() {
        const auto rate = std::uint64_t(options_.mbit * 1e6 / 8);
        DelayProxyOptions network;
        network.server_port = server_->port();
        network.to_client.bytes_per_second = rate;
        network.to_client.queue_bytes = kSlowBufferBytes;
        const auto proxy = DelayProxy::start(network);
        if (!proxy) return tl::unexpected(proxy.error());

        TextTable table({"a slow client's new wish", "old KB", "most", "beyond sockets, most",
                         "after 50 ms, most", "first new page ms", "most"});
        nlohmann::json json;
        RawStreamOptions slow;
        slow.bytes_per_second = rate;
        slow.receive_buffer_bytes = kSlowBufferBytes;
        auto direct = trial(table, "reads slowly", server_->port(), slow, /*through_proxy=*/false);
        if (!direct) return direct;
        auto through =
            trial(table, "reads through a slow network", (*proxy)->port(), {}, /*through_proxy=*/true);
        if (!through) return through;
        options_.print(fmt::format("At {} Mbit/s, of {} trials:", options_.mbit, kTrials));
        options_.print(table.text());
        return nlohmann::json{{"mbit", options_.mbit},
                              {"trials", kTrials},
                              {"reads_slowly", std::move(*direct)},
                              {"slow_network", std::move(*through)}};
    }

    const BenchOptions& options_;
    ServedSubject subject_;
    std::vector<ViewerPath> paths_;
    std::unique_ptr<ServerProcess> server_;
    ViewerSettings settings_;
};

}  // namespace

Result<nlohmann::json> benchFairness(const BenchOptions& options) { return FairnessBench(options).run(); }

}  // namespace brickyard
