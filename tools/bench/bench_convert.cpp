// `brickyard bench convert`: seconds, processors, memory and bytes of `brickyard convert` as a person runs
// it, beside `nanovdb_convert` on the same caches and `zstd` on the same raw dump.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <fstream>
#include <optional>
#include <sstream>

#include "core/printable_name.h"
#include "tools/bench/bench_cache.h"
#include "tools/bench/benchmark.h"
#include "tools/bench/child_process.h"
#include "tools/bench/text_table.h"

namespace brickyard {
namespace {

constexpr std::chrono::minutes kDeadline{60};  // of one run; a raw dump may have hundreds of gigabytes
constexpr double kEnoughSeconds = 60;          // in all runs of one contestant at one input
constexpr double kErrorOfRange = 0.001;
constexpr unsigned kRawThreads = 2;          // of both sides, whatever the machine has
constexpr std::uint32_t kLeastRawEdge = 16;  // what `brickyard synth` makes
constexpr double kLargeRawBytes = double(1ull << 32);

// What is wanted of the converter. A cache counts as half-saved when all its floating channels are.
constexpr double kMostOfZip = 1, kMostOfBlosc = 2, kLeastOfZstd = 0.7, kMostLossless = 1,
                 kTargetLosslessFloat = 0.9, kMostAtErrorFloat = 0.3, kMostAtErrorHalf = 0.5;

using Json = nlohmann::json;

// A program that makes `output` of the input.
struct Contestant {
    std::string name, key;  // for a person; in the JSON
    std::vector<std::string> arguments;
    std::filesystem::path output;

    std::optional<ChildRun> best{};  // of the runs that succeeded, by seconds
    double total_seconds = 0;
    std::uint64_t output_bytes = 0;
    std::string failure{};  // why it is left out; empty: it is not
};

std::string readText(const std::filesystem::path& file) {
    std::ifstream stream(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
}

std::vector<std::string> linesOf(const std::string& text) {
    std::vector<std::string> lines;
    std::istringstream stream(text);
    for (std::string line; std::getline(stream, line);)
        if (!line.empty()) lines.push_back(validUtf8(line));
    return lines;
}

// Of a file, or of all files of a folder.
std::uint64_t bytesIn(const std::filesystem::path& path) {
    std::error_code error;
    if (std::filesystem::is_regular_file(path, error)) return std::filesystem::file_size(path, error);
    std::uint64_t bytes = 0;
    for (const auto& entry : std::filesystem::recursive_directory_iterator(path, error))
        if (entry.is_regular_file(error)) bytes += entry.file_size(error);
    return bytes;
}

Json toJson(const Contestant& contestant, std::uint64_t input_bytes) {
    if (!contestant.failure.empty()) return {{"skipped", contestant.failure}};
    return {{"seconds", contestant.best->seconds},
            {"cpu_seconds", contestant.best->cpu_seconds},
            {"cores_busy", contestant.best->coresBusy()},
            {"peak_bytes", contestant.best->peak_bytes},
            {"output_bytes", contestant.output_bytes},
            {"output_over_input", double(contestant.output_bytes) / double(input_bytes)}};
}

// The worst of what one wish is held to.
struct Goal {
    std::string what, key;
    double limit = 0;
    bool at_least = false;  // else at most
    std::optional<double> worst{};

    void add(double value) {
        if (!std::isfinite(value)) return;
        worst = !worst ? value : at_least ? std::min(*worst, value) : std::max(*worst, value);
    }
    bool met() const { return worst && (at_least ? *worst >= limit : *worst <= limit); }
};

class ConvertBench {
public:
    explicit ConvertBench(const BenchOptions& options) : options_(options) {}

    Result<Json> run() {
        const Result<std::filesystem::path> own = ownProgram();
        if (!own) return tl::unexpected(own.error());
        brickyard_ = own->string();
        const Result<std::vector<BenchCache>> caches = findAllCaches(options_.data);
        if (!caches) return tl::unexpected(caches.error());
        if (!findProgram("nanovdb_convert"))
            skipped_.push_back("nanovdb_convert: not installed (package libnanovdb-tools)");
        if (!findProgram("zstd")) skipped_.push_back("zstd: not installed (package zstd)");

        Json json{{"caches", Json::array()}};
        for (const BenchCache& cache : *caches) {
            Result<Json> figures = measureCache(cache);
            if (!figures) return tl::unexpected(figures.error());
            json["caches"].push_back(std::move(*figures));
        }
        options_.print("\nCaches, the least time of each program:\n" + times_.text());
        options_.print(fmt::format("\nBytes of ours, all levels included, over the source's; at {} % of each "
                                   "channel's range:\n",
                                   100 * kErrorOfRange) +
                       sizes_.text());
        if (!notes_.empty())
            options_.print(
                fmt::format("  What brickyard convert said; the bytes of these caches count for no goal:\n{}",
                            fmt::join(notes_, "\n")));
        Result<Json> raw = measureRaw();
        if (!raw) return tl::unexpected(raw.error());
        json["raw"] = std::move(*raw);
        json["goals"] = printGoals();
        for (const std::string& reason : skipped_) options_.print("  left out: " + reason);
        json["skipped"] = skipped_;
        return json;
    }

private:
    std::filesystem::path scratch(const std::string& name) const { return options_.scratch / name; }
    void remove(const std::filesystem::path& path) const {
        std::error_code ignored;
        std::filesystem::remove_all(path, ignored);
    }

    // Once, into an empty place. A peer that fails is left out from then on; that ours fails is an error.
    Result<void> runOnce(Contestant& contestant) {
        remove(contestant.output);
        const auto run = runChild(contestant.arguments, scratch("out"), scratch("err"), kDeadline);
        if (!run) return tl::unexpected(run.error());
        contestant.output_bytes = bytesIn(contestant.output);
        contestant.total_seconds += run->seconds;
        if (run->status != 0 || contestant.output_bytes == 0) {
            std::string said = readText(scratch("err"));
            said = validUtf8(said.substr(0, said.find('\n')));
            contestant.failure =
                fmt::format("{}: {}", contestant.name,
                            !said.empty()      ? said
                            : run->status == 0 ? "wrote nothing"
                                               : fmt::format("ended with status {}", run->status));
            if (contestant.arguments[0] == brickyard_)
                return fail(ErrorCode::kUnsupported, contestant.failure);
            return {};
        }
        if (!contestant.best || run->seconds < contestant.best->seconds) contestant.best = *run;
        return {};
    }

    // In turns, so that a busy moment hits all.
    Result<void> runInTurns(std::vector<Contestant>& contestants) {
        for (unsigned round = 0; round < options_.repeats; ++round)
            for (Contestant& contestant : contestants) {
                if (!contestant.failure.empty() || contestant.total_seconds > kEnoughSeconds) continue;
                options_.progress(fmt::format("convert: {}, {} of {}", contestant.arguments.back(), round + 1,
                                              options_.repeats));
                if (Result<void> done = runOnce(contestant); !done) return done;
            }
        for (const Contestant& contestant : contestants)
            if (!contestant.failure.empty()) skipped_.push_back(contestant.failure);
        return {};
    }

    std::vector<Contestant> contestantsOf(const BenchCache& cache) const {
        const std::string input = cache.file.string();
        std::vector<Contestant> contestants;
        const auto add = [&](const std::string& name, const std::string& key,
                             std::vector<std::string> arguments, const std::filesystem::path& output) {
            arguments.push_back(input);
            arguments.push_back(output.string());
            contestants.push_back({.name = name, .key = key, .arguments = arguments, .output = output});
        };
        add("brickyard convert", "ours", {brickyard_, "convert", "--json"}, scratch("ours.bricks"));
        if (const auto peer = findProgram("nanovdb_convert")) {
            add("nanovdb_convert -z", "zip", {peer->string(), "-f", "-z"}, scratch("zip.nvdb"));
            add("nanovdb_convert -b", "blosc", {peer->string(), "-f", "-b"}, scratch("blosc.nvdb"));
        }
        return contestants;
    }

    Result<Json> measureCache(const BenchCache& cache) {
        const std::uint64_t input_bytes = bytesIn(cache.file);
        std::vector<Contestant> contestants = contestantsOf(cache);
        // Ours first, so that its words about the channels are read before the next run replaces them.
        if (Result<void> done = runOnce(contestants[0]); !done) return tl::unexpected(done.error());
        const Json said = Json::parse(readText(scratch("out")), nullptr, /*allow_exceptions=*/false);
        if (!said.is_object() || !said.contains("channels"))
            return fail(ErrorCode::kUnsupported,
                        fmt::format("{}: brickyard convert --json said nothing that is understood",
                                    cache.file.string()));
        const std::vector<std::string> notes = linesOf(readText(scratch("err")));
        contestants[0].best.reset();  // it had to read the file from disk
        if (Result<void> done = runInTurns(contestants); !done) return tl::unexpected(done.error());

        Json json{{"name", cache.name}, {"input_bytes", input_bytes}, {"notes", notes}};
        for (const std::string& note : notes) notes_.push_back(fmt::format("  {}: {}", cache.name, note));
        const double ours = contestants[0].best->seconds;
        for (std::size_t i = 0; i < contestants.size(); ++i) {
            const Contestant& contestant = contestants[i];
            json[contestant.key] = toJson(contestant, input_bytes);
            if (!contestant.failure.empty()) continue;
            const double ratio = ours / contestant.best->seconds;
            // On a busy machine it says more than seconds, of which some are others'.
            const double cpu_ratio = contestants[0].best->cpu_seconds / contestant.best->cpu_seconds;
            if (i > 0) {
                json["ours_over_" + contestant.key] = ratio;
                json["ours_over_" + contestant.key + "_cpu"] = cpu_ratio;
                goals_[contestant.key == "zip" ? kZip : kBlosc].add(ratio);
            }
            times_.add({i == 0 ? cache.name : "", contestant.name, cell(contestant.best->seconds),
                        i == 0 ? "" : cell(ratio), cell(contestant.best->cpu_seconds),
                        i == 0 ? "" : cell(cpu_ratio), cell(contestant.best->coresBusy()),
                        megabytes(contestant.best->peak_bytes), megabytes(contestant.output_bytes),
                        relative(contestant.output_bytes, input_bytes)});
        }
        if (Result<void> sizes = measureSizes(cache, said["channels"], contestants[0], json); !sizes)
            return tl::unexpected(sizes.error());
        for (const Contestant& contestant : contestants) remove(contestant.output);
        return json;
    }

    // The lossless bytes are known; once more with an error for each channel.
    Result<void> measureSizes(const BenchCache& cache, const Json& channels, const Contestant& lossless,
                              Json& json) {
        Contestant lossy{.name = "brickyard convert --error",
                         .key = "ours_at_error",
                         .arguments = {brickyard_, "convert"},
                         .output = scratch("error.bricks")};
        bool half = true, floating = false;
        for (const Json& channel : channels) {
            const std::string type = channel["type"];
            if (type != "float32" && type != "float64") continue;
            floating = true;
            half = half && channel["saved_as_half"].get<bool>();
            const double range = channel["range"][1].get<double>() - channel["range"][0].get<double>();
            lossy.arguments.insert(lossy.arguments.end(),
                                   {"--error", fmt::format("{}={:.17g}", channel["name"].get<std::string>(),
                                                           kErrorOfRange * std::max(range, 0.0))});
        }
        half = half && floating;
        lossy.arguments.insert(lossy.arguments.end(), {cache.file.string(), lossy.output.string()});
        if (Result<void> done = runOnce(lossy); !done) return done;
        const std::uint64_t input_bytes = bytesIn(cache.file);
        const double exact = double(lossless.output_bytes) / double(input_bytes);
        const double at_error = double(lossy.output_bytes) / double(input_bytes);
        json["saved_as_half"] = half;
        json["ours_at_error"] = toJson(lossy, input_bytes);
        // Where grids were left out, the bytes of the others are no match for the whole source.
        if (json["notes"].empty()) {
            goals_[kLossless].add(exact);
            if (!half) goals_[kLosslessFloat].add(exact);
            goals_[half ? kErrorHalf : kErrorFloat].add(at_error);
        }
        sizes_.add({cache.name, half ? "half" : "float", fmt::format("{:.3f}", double(input_bytes) / 1e6),
                    fmt::format("{:.3f}", exact), fmt::format("{:.3f}", at_error)});
        remove(lossy.output);
        return {};
    }

    Result<Json> measureRaw() {
        const std::uint32_t edge = std::max(options_.size, kLeastRawEdge);
        const std::filesystem::path input = scratch("scan.raw");
        options_.progress(fmt::format("convert: making a raw dump of {}^3", edge));
        Contestant synth{
            .name = "brickyard synth",
            .key = "synth",
            .arguments = {brickyard_, "synth", "raw", input.string(), "--size", std::to_string(edge)},
            .output = input};
        if (Result<void> made = runOnce(synth); !made) return tl::unexpected(made.error());
        const std::uint64_t bytes = bytesIn(input);

        std::vector<Contestant> contestants;
        const std::filesystem::path ours = scratch("raw.bricks"), peer_output = scratch("scan.zst");
        contestants.push_back(
            {.name = "brickyard convert",
             .key = "ours",
             .arguments = {brickyard_, "convert", "--raw", fmt::format("{0}x{0}x{0}:uint16", edge), "--jobs",
                           std::to_string(kRawThreads), input.string(), ours.string()},
             .output = ours});
        if (const auto zstd = findProgram("zstd"))
            contestants.push_back({.name = fmt::format("zstd -T{} -1", kRawThreads),
                                   .key = "zstd",
                                   .arguments = {zstd->string(), fmt::format("-T{}", kRawThreads), "-1", "-q",
                                                 "-f", "-k", "-o", peer_output.string(), input.string()},
                                   .output = peer_output});
        if (Result<void> done = runInTurns(contestants); !done) return tl::unexpected(done.error());

        Json json{{"edge", edge}, {"input_bytes", bytes}};
        TextTable table(
            {"program", "seconds", "MB/s", "CPU s", "cores busy", "peak MB", "MB out", "of source"});
        for (const Contestant& contestant : contestants) {
            json[contestant.key] = toJson(contestant, bytes);
            if (!contestant.failure.empty()) continue;
            const ChildRun& best = *contestant.best;
            json[contestant.key]["megabytes_per_second"] = double(bytes) / 1e6 / best.seconds;
            table.add({contestant.name, cell(best.seconds), cell(double(bytes) / 1e6 / best.seconds),
                       cell(best.cpu_seconds), cell(best.coresBusy()), megabytes(best.peak_bytes),
                       megabytes(contestant.output_bytes), relative(contestant.output_bytes, bytes)});
        }
        options_.print(fmt::format("\nA raw dump of {}^3 uint16, {:.1f} MB, {} threads:\n", edge,
                                   double(bytes) / 1e6, kRawThreads) +
                       table.text());
        if (contestants.size() > 1 && contestants[1].best) {
            const double ratio = contestants[1].best->seconds / contestants[0].best->seconds;
            json["ours_over_zstd"] = ratio;
            if (double(bytes) > kLargeRawBytes) goals_[kZstd].add(ratio);
            options_.print(fmt::format("  ours is {} times as fast as zstd{}", cell(ratio),
                                       double(bytes) > kLargeRawBytes
                                           ? ""
                                           : "; the goal is meant for more than 4 GiB (--size 1291 and up)"));
        }
        remove(input);
        for (const Contestant& contestant : contestants) remove(contestant.output);
        return json;
    }

    Json printGoals() {
        options_.print("\nGoals, each by its worst case:");
        Json json = Json::array();
        for (const Goal& goal : goals_) {
            const std::string limit =
                fmt::format("{} {}", goal.at_least ? "at least" : "at most", cell(goal.limit));
            if (!goal.worst) {
                options_.print(fmt::format("  {}: {}; not measured", goal.what, limit));
                continue;
            }
            options_.print(fmt::format("  {}: {}; is {}: {}", goal.what, limit, cell(*goal.worst),
                                       goal.met() ? "met" : "MISSED"));
            json.push_back({{"goal", goal.key},
                            {"limit", goal.limit},
                            {"at_least", goal.at_least},
                            {"worst", *goal.worst},
                            {"met", goal.met()}});
        }
        return json;
    }

    static std::string megabytes(std::uint64_t bytes) { return fmt::format("{:.2f}", double(bytes) / 1e6); }
    static std::string relative(std::uint64_t bytes, std::uint64_t source) {
        return fmt::format("{:.3f}", double(bytes) / double(source));
    }

    enum { kZip, kBlosc, kZstd, kLossless, kLosslessFloat, kErrorFloat, kErrorHalf };

    const BenchOptions& options_;
    std::string brickyard_;
    std::vector<std::string> skipped_, notes_;
    TextTable times_{{"cache", "program", "seconds", "ours/it", "CPU s", "CPU ours/it", "cores busy",
                      "peak MB", "MB out", "of source"}};
    TextTable sizes_{{"cache", "saved as", "source MB", "lossless", "at error"}};
    std::vector<Goal> goals_{
        {"seconds over nanovdb_convert -z", "seconds_over_zip", kMostOfZip},
        {"seconds over nanovdb_convert -b", "seconds_over_blosc", kMostOfBlosc},
        {"MB/s of raw input over zstd", "raw_speed_over_zstd", kLeastOfZstd, /*at_least=*/true},
        {"bytes over the source, lossless", "lossless", kMostLossless},
        {"the same, float caches (target)", "lossless_float_target", kTargetLosslessFloat},
        {"bytes at 0.1 %, float caches", "at_error_float", kMostAtErrorFloat},
        {"bytes at 0.1 %, half-saved caches", "at_error_half", kMostAtErrorHalf}};
};

}  // namespace

Result<nlohmann::json> benchConvert(const BenchOptions& options) { return ConvertBench(options).run(); }

}  // namespace brickyard
