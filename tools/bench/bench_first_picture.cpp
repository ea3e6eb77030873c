// `brickyard bench first-picture`: how soon a cold client has a picture over a far network, told with the
// greeting what it will need, and finding that out by itself.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "tools/bench/benchmark.h"
#include "tools/bench/delay_proxy.h"
#include "tools/bench/picture_race.h"
#include "tools/bench/raw_stream.h"
#include "tools/bench/server_process.h"
#include "tools/bench/stream_views.h"
#include "tools/bench/text_table.h"
#include "tools/bench/timing.h"

namespace brickyard {
namespace {

using Clock = std::chrono::steady_clock;

// Pictures are at most this wide: every stretch of every ray is kept.
constexpr std::uint32_t kLargestPicture = 192;
constexpr double kMedianDepth = 1;
constexpr double kStopPsnr = 40;
constexpr unsigned kMostRounds = 3;
// The delay that was asked for, and twice that.
constexpr double kDelayFactors[] = {1, 2};
constexpr std::size_t kClients = std::size(kRaceClients);
constexpr std::size_t kOurs = 3;  // the first of kRaceClients; the others are peers

// What is compared: the picture's seconds to each of these.
using Goal = std::optional<RaceMark> RaceRun::*;
constexpr Goal kGoals[] = {&RaceRun::first, &RaceRun::at_30_db, &RaceRun::at_40_db};
constexpr const char* kGoalNames[] = {"first_picture", "30_db", "40_db"};

// Of one client in one view: the medians.
struct Standing {
    double seconds[std::size(kGoals)];  // NaN where it was never reached
    double round_trips[std::size(kGoals)];
    double kilobytes[std::size(kGoals)];
};

Standing standingOf(const std::vector<RaceRun>& runs) {
    Standing standing;
    for (std::size_t g = 0; g < std::size(kGoals); ++g) {
        Timing seconds, trips, bytes;
        for (const RaceRun& run : runs) {
            const std::optional<RaceMark>& mark = run.*kGoals[g];
            if (!mark) continue;
            seconds.add(mark->seconds);
            trips.add(double(mark->round_trips));
            bytes.add(double(mark->bytes) * 1e-3);
        }
        const bool all = !runs.empty() && runs.back().*kGoals[g];
        standing.seconds[g] = all ? seconds.median() : std::nan("");
        standing.round_trips[g] = all ? trips.median() : std::nan("");
        standing.kilobytes[g] = all ? bytes.median() : std::nan("");
    }
    return standing;
}

class FirstPictureBench {
public:
    explicit FirstPictureBench(const BenchOptions& options)
        : options_(options), edge_(std::min(options.size, kLargestPicture)) {}

    Result<nlohmann::json> run() {
        Result<ServedSubject> subject = convertServed(options_);
        if (!subject) return tl::unexpected(subject.error());
        Result<std::unique_ptr<ServerProcess>> server =
            ServerProcess::start(subject->folder, options_.scratch);
        if (!server) return tl::unexpected(server.error());
        server_ = std::move(*server);
        const SubjectFrame& frame = subject->frames.back();

        nlohmann::json json{{"cache", subject->cache}, {"frame", frame.frame}, {"size", edge_}};
        const Result<ServerUsage> before = server_->usage();
        if (!before) return tl::unexpected(before.error());
        const Clock::time_point began = Clock::now();
        for (double factor : kDelayFactors) {
            Result<nlohmann::json> figures = overNetwork(*subject, frame, factor * options_.delay_ms);
            if (!figures) return figures;
            json["networks"].push_back(std::move(*figures));
        }
        const Result<ServerUsage> after = server_->usage();
        if (!after) return tl::unexpected(after.error());
        const double seconds = std::chrono::duration<double>(Clock::now() - began).count();
        options_.print(usageText(*before, *after, seconds));
        json["server"] = usageJson(*before, *after, seconds);
        return json;
    }

private:
    Result<std::unique_ptr<DelayProxy>> makeNetwork(double round_trip_ms) const {
        DelayProxyOptions network;
        network.server_port = server_->port();
        for (DelayProxyLink* link : {&network.to_server, &network.to_client}) {
            link->delay = std::chrono::microseconds(std::int64_t(round_trip_ms * 500));
            link->bytes_per_second = std::uint64_t(options_.mbit * 1e6 / 8);
        }
        return DelayProxy::start(network);
    }

    // A Ping's way there and back, the least of a few.
    static Result<double> measureRoundTrip(std::uint16_t port, const std::string& dataset) {
        Result<RawStream> stream = RawStream::open(port, dataset);
        if (!stream) return tl::unexpected(stream.error());
        double least = std::numeric_limits<double>::infinity();
        for (int i = 0; i < 3; ++i) {
            StreamHeader ping;
            ping.mutable_ping()->set_number(1);
            const Clock::time_point sent = Clock::now();
            if (Result<void> done = stream->send(ping); !done) return tl::unexpected(done.error());
            const auto pong = stream->receive(sent + std::chrono::seconds(60));
            if (!pong) return tl::unexpected(pong.error());
            least = std::min(least, std::chrono::duration<double, std::milli>(Clock::now() - sent).count());
        }
        return least;
    }

    Result<nlohmann::json> overNetwork(const ServedSubject& subject, const SubjectFrame& frame,
                                       double round_trip_ms) {
        const auto network = makeNetwork(round_trip_ms);
        if (!network) return tl::unexpected(network.error());
        StreamAddress address = server_->address();
        address.port = (*network)->port();
        const Result<double> measured = measureRoundTrip(address.port, address.dataset);
        if (!measured) return tl::unexpected(measured.error());

        std::optional<double> scale;
        nlohmann::json views;
        TextTable table({"seconds to, KB, round trips", "first", "", "", "30 dB", "", "", "40 dB", "", ""});
        std::vector<std::vector<Standing>> standings;  // by view, by client
        std::vector<BenchView> all = streamViews(frame.footer());
        // The framing view sets the density.
        std::partition(all.begin(), all.end(), [](const BenchView& v) { return v.name == "framing"; });
        for (const BenchView& view : all) {
            options_.progress(fmt::format("round trip {} ms, {}", round_trip_ms, view.name));
            const Result<PinholeCamera> camera = PinholeCamera::create(view.camera, edge_, edge_);
            if (!camera) return tl::unexpected(camera.error());
            if (!scale) {
                const Result<double> found =
                    streamScale(frame.reader->store(), frame.channel, *camera, kMedianDepth);
                if (!found) return tl::unexpected(found.error());
                scale = *found;
            }
            const Result<StreamTable> pages =
                StreamTable::create(frame.reader->store(), frame.channel, *camera, *scale);
            if (!pages) return tl::unexpected(pages.error());
            const RaceSetup setup{address, frame, *pages, view.camera, *camera, *scale, kStopPsnr};
            std::vector<std::vector<RaceRun>> runs(kClients);
            for (unsigned round = 0; round < std::min(options_.repeats, kMostRounds); ++round)
                for (std::size_t c = 0; c < kClients; ++c) {
                    Result<RaceRun> run = runRace(setup, kRaceClients[c]);
                    if (!run) return tl::unexpected(run.error());
                    runs[c].push_back(std::move(*run));
                }
            standings.emplace_back();
            for (std::size_t c = 0; c < kClients; ++c) {
                standings.back().push_back(standingOf(runs[c]));
                views.push_back(note(table, view.name, toString(kRaceClients[c]), standings.back().back(),
                                     runs[c].back()));
            }
        }
        options_.print(
            fmt::format("{} frame {}, {} x {} pixels, over {} Mbit/s and a round trip of {} ms ({:.1f} ms "
                        "measured); TCP and "
                        "WebSocket take two of them before the round trips that are counted here:",
                        subject.cache, frame.frame, edge_, edge_, options_.mbit, round_trip_ms, *measured));
        options_.print(table.text());
        nlohmann::json json{{"round_trip_ms", round_trip_ms},
                            {"round_trip_ms_measured", *measured},
                            {"mbit", options_.mbit},
                            {"runs", std::move(views)}};
        json["quickest_peer_over_ours"] = compare(standings);
        return json;
    }

    static nlohmann::json note(TextTable& table, const std::string& view, const std::string& client,
                               const Standing& standing, const RaceRun& last) {
        nlohmann::json json{{"view", view}, {"client", client}, {"psnr_at_the_end", last.psnr}};
        std::vector<std::string> row{view + ": " + client};
        for (std::size_t g = 0; g < std::size(kGoals); ++g) {
            row.push_back(cell(standing.seconds[g]));
            row.push_back(cell(standing.kilobytes[g]));
            row.push_back(cell(standing.round_trips[g]));
            json[kGoalNames[g]] = {{"seconds", standing.seconds[g]},
                                   {"bytes", standing.kilobytes[g] * 1e3},
                                   {"round_trips", standing.round_trips[g]}};
        }
        table.add(std::move(row));
        return json;
    }

    // The quickest peer's seconds over each of ours: geometric mean and least over the views.
    nlohmann::json compare(const std::vector<std::vector<Standing>>& standings) const {
        nlohmann::json json;
        TextTable table({"quickest peer's seconds over", "first", "30 dB", "40 dB"});
        for (std::size_t c = 0; c < kOurs; ++c) {
            std::vector<std::string> row{toString(kRaceClients[c])};
            for (std::size_t g = 0; g < std::size(kGoals); ++g) {
                double logs = 0, least = std::numeric_limits<double>::infinity();
                for (const std::vector<Standing>& view : standings) {
                    double peer = std::numeric_limits<double>::infinity();
                    for (std::size_t p = kOurs; p < kClients; ++p) peer = std::fmin(peer, view[p].seconds[g]);
                    const double ratio = peer / view[c].seconds[g];
                    logs += std::log(ratio);
                    least = std::min(least, ratio);
                }
                const double mean = std::exp(logs / double(standings.size()));
                row.push_back(fmt::format("{} ({})", cell(mean), cell(least)));
                json[toString(kRaceClients[c])][kGoalNames[g]] = {{"mean", mean}, {"least", least}};
            }
            table.add(std::move(row));
        }
        options_.print(table.text());
        return json;
    }

    const BenchOptions& options_;
    const std::uint32_t edge_;
    std::unique_ptr<ServerProcess> server_;
};

}  // namespace

Result<nlohmann::json> benchFirstPicture(const BenchOptions& options) {
    return FirstPictureBench(options).run();
}

}  // namespace brickyard
