// `brickyard bench codec`: bytes and speed of our brick codec beside zfp, Blosc and zstd on the same bricks,
// lossless and at the same measured error.
#include <fmt/format.h>

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>
#include <map>

#include "core/brick_codec.h"
#include "tools/bench/bench_cache.h"
#include "tools/bench/benchmark.h"
#include "tools/bench/codec_samples.h"
#include "tools/bench/text_table.h"
#include "tools/bench/timing.h"

namespace brickyard {
namespace {

constexpr std::size_t kMostChannelBytes = 8 << 20;  // of samples; more bricks are chosen from evenly
constexpr double kEnoughSeconds = 0.2;
constexpr int kZstdLevel = 1, kBloscLz4Level = 9, kBloscZstdLevel = 1;  // Blosc's 1 is zstd's 1
constexpr double kModes[] = {0, 1e-3, 1e-4};                            // of a channel's range; 0: lossless

using Json = nlohmann::json;

// Without states and without drafts: samples alone, as the peers have them.
class OurCodec final : public SampleCodec {
public:
    OurCodec(const CodecChannel& channel, double max_error)
        : shape_{channel.shape.edge_samples - 1},
          components_(channel.shape.components),
          background_(channel.background),
          max_error_(max_error) {}

    void encode(std::span<const float> values, std::vector<std::byte>& out) const override {
        BrickToEncode brick;
        brick.shape = shape_;
        brick.components = components_;
        brick.values = std::as_bytes(values);
        brick.background = background_;
        brick.max_error = max_error_;
        out = encodeBrick(brick).payload;
    }
    bool decode(std::span<const std::byte> bytes, std::span<float> out) const override {
        return bool(decodeBrickToFloat(bytes, shape_, SampleType::kFloat32, components_, out));
    }
    std::size_t codedSamples() const override { return shape_.samples() * std::size_t(components_); }

private:
    BrickShape shape_;
    int components_;
    std::vector<ValueBits> background_;
    double max_error_;
};

using Codec = std::unique_ptr<SampleCodec>;

// A codec with one setting for each channel of a cache.
struct CodecContender {
    std::string name, key;
    std::vector<Codec> codecs{};

    std::size_t bytes = 0, samples = 0;
    double error_of_range = 0;  // largest, measured
    double encode_seconds = 0, decode_seconds = 0;
    double bytesPerSample() const { return double(bytes) / double(samples); }
    double encodeSpeed() const { return double(samples) * sizeof(float) / 1e6 / encode_seconds; }
    double decodeSpeed() const { return double(samples) * sizeof(float) / 1e6 / decode_seconds; }
};

// Largest |decoded - value| over a channel; infinite where the codec refuses what it wrote.
double measuredError(const CodecChannel& channel, const SampleCodec& codec) {
    std::vector<std::byte> bytes;
    std::vector<float> decoded;
    double worst = 0;
    for (const std::vector<float>& values : channel.bricks) {
        codec.encode(values, bytes);
        // Where a codec leaves samples out, there is nothing to hold against it.
        if (codec.codedSamples() == values.size())
            decoded.assign(values.size(), std::numeric_limits<float>::quiet_NaN());
        else
            decoded = values;
        if (!codec.decode(bytes, decoded)) return std::numeric_limits<double>::infinity();
        for (std::size_t i = 0; i < values.size(); ++i) {
            const double error = std::abs(double(decoded[i]) - double(values[i]));
            worst = error <= worst      ? worst
                    : std::isnan(error) ? std::numeric_limits<double>::infinity()
                                        : error;
        }
    }
    return worst;
}

// The coarsest power of two at which zfp's measured error stays within `most`: it knows no tolerances
// between.
int zfpExponent(const CodecChannel& channel, double most, bool last_face) {
    // Its errors are below its tolerance, by what depends on the data.
    int within = std::ilogb(most) - 1, beyond = within + 10;
    while (beyond - within > 1) {
        const int middle = (within + beyond) / 2;
        const Codec codec = makeZfpCodec(channel.shape, middle, last_face);
        (measuredError(channel, *codec) <= most ? within : beyond) = middle;
    }
    return within;
}

WordGrid gridOf(const CodecChannel& channel, double max_error) {
    // A little finer than twice the error: floats are rounded once more.
    WordGrid grid{channel.least, 2 * max_error * (1 - 1e-3), true};
    grid.narrow = (channel.greatest - channel.least) / grid.step < 65535;
    return grid;
}

class CacheCodecs {
public:
    CacheCodecs(const std::vector<CodecChannel>& channels, double error_of_range)
        : channels_(channels), error_of_range_(error_of_range) {
        addOurs();
        if (error_of_range > 0) {
            addZfpAtError();
        } else {
            add("zfp reversible", "zfp", [](const CodecChannel& channel) {
                return makeZfpCodec(channel.shape, std::nullopt, /*last_face=*/true);
            });
            add("zfp reversible, N^3", "zfp_without_face", [](const CodecChannel& channel) {
                return makeZfpCodec(channel.shape, std::nullopt, /*last_face=*/false);
            });
        }
        const auto gridFor = [error_of_range](const CodecChannel& channel) -> std::optional<WordGrid> {
            if (error_of_range == 0) return std::nullopt;
            return gridOf(channel, error_of_range * channel.range());
        };
        add("Blosc lz4", "blosc_lz4", [&](const CodecChannel& channel) {
            return makeBloscCodec(channel.shape, gridFor(channel), "lz4", kBloscLz4Level);
        });
        add("Blosc zstd", "blosc_zstd", [&](const CodecChannel& channel) {
            return makeBloscCodec(channel.shape, gridFor(channel), "zstd", kBloscZstdLevel);
        });
        add("zstd -1", "zstd", [&](const CodecChannel& channel) {
            return makeZstdCodec(channel.shape, gridFor(channel), kZstdLevel);
        });
    }

    Result<std::vector<CodecContender>> measure() {
        for (CodecContender& contender : contenders_) {
            for (std::size_t c = 0; c < channels_.size(); ++c)
                contender.error_of_range =
                    std::max(contender.error_of_range,
                             measuredError(channels_[c], *contender.codecs[c]) / channels_[c].range());
            if (!std::isfinite(contender.error_of_range))
                return fail(ErrorCode::kCorrupt,
                            fmt::format("{}: does not decode what it encoded", contender.name));
            time(contender);
        }
        return std::move(contenders_);
    }

private:
    template <class Make>
    void add(const std::string& name, const std::string& key, const Make& make) {
        CodecContender contender{.name = name, .key = key};
        for (const CodecChannel& channel : channels_) contender.codecs.push_back(make(channel));
        contenders_.push_back(std::move(contender));
    }

    void addOurs() {
        add("ours", "ours", [this](const CodecChannel& channel) -> Codec {
            return std::make_unique<OurCodec>(channel, error_of_range_ * channel.range());
        });
    }

    // zfp no worse than ours, and then ours no worse than zfp: with powers of two the first alone would make
    // zfp up to twice as exact as it had to be.
    void addZfpAtError() {
        std::map<std::string, double> made, zfp_made;
        for (std::size_t c = 0; c < channels_.size(); ++c) {
            const double asked = error_of_range_ * channels_[c].range();
            const double error = measuredError(channels_[c], *contenders_[0].codecs[c]);
            // Where ours came out exact, as few values do, zfp may still make the error that was allowed.
            made[channels_[c].name] = error > 0 ? error : asked;
        }
        const auto zfp = [&](bool last_face) {
            return [&made, last_face](const CodecChannel& channel) {
                return makeZfpCodec(channel.shape, zfpExponent(channel, made[channel.name], last_face),
                                    last_face);
            };
        };
        add("zfp", "zfp", zfp(true));
        for (std::size_t c = 0; c < channels_.size(); ++c)
            zfp_made[channels_[c].name] = measuredError(channels_[c], *contenders_.back().codecs[c]);
        add("zfp, N^3", "zfp_without_face", zfp(false));
        add("ours at zfp's error", "ours_at_zfp", [&](const CodecChannel& channel) -> Codec {
            return std::make_unique<OurCodec>(channel, zfp_made[channel.name]);
        });
    }

    // Passes over all bricks on this thread until they are long enough to be timed; the best counts.
    void time(CodecContender& contender) const {
        std::vector<std::vector<std::byte>> payloads;
        std::vector<const CodecChannel*> channel_of;
        std::vector<const SampleCodec*> codec_of;
        std::vector<const std::vector<float>*> bricks;
        for (std::size_t c = 0; c < channels_.size(); ++c)
            for (const std::vector<float>& brick : channels_[c].bricks) {
                bricks.push_back(&brick);
                codec_of.push_back(contender.codecs[c].get());
                contender.samples += contender.codecs[c]->codedSamples();
            }
        payloads.resize(bricks.size());
        contender.encode_seconds = bestPass([&] {
            for (std::size_t i = 0; i < bricks.size(); ++i) codec_of[i]->encode(*bricks[i], payloads[i]);
        });
        for (const std::vector<std::byte>& payload : payloads) contender.bytes += payload.size();
        std::vector<float> decoded;
        contender.decode_seconds = bestPass([&] {
            for (std::size_t i = 0; i < bricks.size(); ++i) {
                decoded.resize(bricks[i]->size());
                [[maybe_unused]] const bool read = codec_of[i]->decode(payloads[i], decoded);
                assert(read && "it was decoded when its error was measured");
            }
        });
    }

    template <class Pass>
    static double bestPass(const Pass& pass) {
        Timing timing;
        do timing.add(secondsOf(pass));
        while (timing.total() < kEnoughSeconds);
        return timing.best();
    }

    const std::vector<CodecChannel>& channels_;
    double error_of_range_;
    std::vector<CodecContender> contenders_;
};

class CodecBench {
public:
    explicit CodecBench(const BenchOptions& options) : options_(options) {}

    Result<Json> run() {
        const Result<std::vector<BenchCache>> caches = findAllCaches(options_.data);
        if (!caches) return tl::unexpected(caches.error());
        Json json{{"brick", options_.brick_edge}, {"caches", Json::array()}};
        for (const BenchCache& cache : *caches) {
            options_.progress("codec: reading " + cache.name);
            const auto channels =
                readCodecChannels(cache.file, BrickShape{options_.brick_edge}, kMostChannelBytes);
            if (!channels) return tl::unexpected(channels.error());
            if (channels->empty()) {
                options_.print(fmt::format("\n{}: has no float channel with bricks", cache.name));
                continue;
            }
            Json measured = describe(cache, *channels);
            for (const double error : kModes) {
                options_.progress(fmt::format("codec: {}, {}", cache.name, modeName(error)));
                Result<std::vector<CodecContender>> contenders = CacheCodecs(*channels, error).measure();
                if (!contenders)
                    return fail(contenders.error().code,
                                fmt::format("{}: {}", cache.file.string(), contenders.error().message));
                measured["modes"].push_back(report(error, *contenders));
            }
            json["caches"].push_back(std::move(measured));
        }
        json["summary"] = summarise();
        return json;
    }

private:
    static std::string modeName(double error) {
        return error == 0 ? "lossless" : fmt::format("at {} % of each range", 100 * error);
    }

    Json describe(const BenchCache& cache, const std::vector<CodecChannel>& channels) const {
        std::size_t taken = 0, there = 0;
        Json names = Json::array();
        for (const CodecChannel& channel : channels) {
            taken += channel.bricks.size();
            there += channel.places;
            names.push_back(channel.name);
        }
        options_.print(
            fmt::format("\n{}: {} bricks of {}^3 cells, chosen from {} places, in {} float channels",
                        cache.name, taken, there, options_.brick_edge, channels.size()));
        return {{"name", cache.name}, {"channels", names}, {"bricks", taken}, {"places", there}};
    }

    Json report(double error, const std::vector<CodecContender>& contenders) {
        TextTable table({modeName(error), "bytes/sample", "of raw", "error/range", "encode MB/s",
                         "decode MB/s", "bytes ours/it", "encode ours/it", "decode ours/it"});
        Json json{{"error_of_range", error}, {"codecs", Json::array()}};
        const CodecContender& ours = contenders.front();
        for (const CodecContender& it : contenders) {
            const double bytes = ours.bytesPerSample() / it.bytesPerSample();
            const double encode = ours.encodeSpeed() / it.encodeSpeed();
            const double decode = ours.decodeSpeed() / it.decodeSpeed();
            table.add({it.name, fmt::format("{:.3f}", it.bytesPerSample()),
                       fmt::format("{:.3f}", it.bytesPerSample() / sizeof(float)), cell(it.error_of_range),
                       speed(it.encodeSpeed()), speed(it.decodeSpeed()), fmt::format("{:.3f}", bytes),
                       fmt::format("{:.2f}", encode), fmt::format("{:.2f}", decode)});
            json["codecs"].push_back({{"name", it.name},
                                      {"key", it.key},
                                      {"bytes_per_sample", it.bytesPerSample()},
                                      {"of_raw", it.bytesPerSample() / sizeof(float)},
                                      {"error_over_range", it.error_of_range},
                                      {"encode_megabytes_per_second", it.encodeSpeed()},
                                      {"decode_megabytes_per_second", it.decodeSpeed()},
                                      {"ours_over_it_bytes", bytes},
                                      {"ours_over_it_encode_speed", encode},
                                      {"ours_over_it_decode_speed", decode}});
            if (&it != &ours) noteRatio(error, it, {bytes, encode, decode});
        }
        options_.print(table.text());
        // The other way round: ours as exact as zfp came out.
        const auto at_zfp = std::find_if(contenders.begin(), contenders.end(),
                                         [](const CodecContender& it) { return it.key == "ours_at_zfp"; });
        if (at_zfp == contenders.end()) return json;
        const auto zfp = std::find_if(contenders.begin(), contenders.end(),
                                      [](const CodecContender& it) { return it.key == "zfp"; });
        const double ratio = at_zfp->bytesPerSample() / zfp->bytesPerSample();
        json["ours_at_zfp_over_zfp_bytes"] = ratio;
        options_.print(fmt::format("  ours at zfp's error has {:.3f} of zfp's bytes", ratio));
        return json;
    }

    static std::string speed(double megabytes_per_second) {
        return fmt::format("{:.0f}", megabytes_per_second);
    }

    // Logarithms of ours over a peer's, over the caches.
    struct Ratios {
        std::string name;
        double bytes = 0, encode = 0, decode = 0;
        int caches = 0;
    };
    struct Ratio {
        double bytes, encode, decode;
    };
    void noteRatio(double error, const CodecContender& peer, const Ratio& ratio) {
        if (peer.key == "ours_at_zfp") return;
        Ratios& all = ratios_[{error, peer.key}];
        all.name = peer.name;
        all.bytes += std::log(ratio.bytes);
        all.encode += std::log(ratio.encode);
        all.decode += std::log(ratio.decode);
        ++all.caches;
    }

    Json summarise() const {
        TextTable table({"ours over it, geometric means over the caches", "error", "bytes", "encode speed",
                         "decode speed"});
        Json json = Json::array();
        for (const auto& [key, all] : ratios_) {
            const double bytes = std::exp(all.bytes / all.caches), encode = std::exp(all.encode / all.caches),
                         decode = std::exp(all.decode / all.caches);
            table.add({all.name, fmt::format("{} %", 100 * key.first), fmt::format("{:.3f}", bytes),
                       fmt::format("{:.2f}", encode), fmt::format("{:.2f}", decode)});
            json.push_back({{"error_of_range", key.first},
                            {"key", key.second},
                            {"ours_over_it_bytes", bytes},
                            {"ours_over_it_encode_speed", encode},
                            {"ours_over_it_decode_speed", decode}});
        }
        options_.print("\n" + table.text());
        return json;
    }

    const BenchOptions& options_;
    std::map<std::pair<double, std::string>, Ratios> ratios_;  // by the error and the peer's key
};

}  // namespace

Result<nlohmann::json> benchCodec(const BenchOptions& options) { return CodecBench(options).run(); }

}  // namespace brickyard
