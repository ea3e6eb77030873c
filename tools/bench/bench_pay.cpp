// `brickyard bench pay`: bytes, pages and seconds of each feature, switched on alone.
#include <fmt/format.h>

#include <algorithm>

#include "tools/bench/bench_subject.h"
#include "tools/bench/benchmark.h"
#include "tools/bench/text_table.h"
#include "tools/bench/timing.h"

namespace brickyard {
namespace {

constexpr double kEnoughSeconds = 5;

struct Feature {
    std::string name;
    bool light = false, emission = false;
    QualitySettings quality{.max_error = 0.01};
};

// The channel that can glow: one that simulations call so, else any other scalar one. Empty where there is
// none.
std::string emissionChannel(const BenchDataset& dataset, const std::string& density) {
    std::string found;
    for (const ChannelFooter& channel : dataset.footer.channels()) {
        if (channel.components() != 1 || channel.name() == density || channel.active_voxels() == 0) continue;
        const bool known =
            channel.name() == "flame" || channel.name() == "flames" || channel.name() == "temperature";
        if (found.empty() || known) found = channel.name();
        if (channel.name() == "flame") break;
    }
    return found;
}

std::vector<Feature> features(bool emission) {
    std::vector<Feature> list{{"absorption"}, {"+ light", true, false}};
    if (emission) {
        list.push_back({"+ emission", false, true});
        list.push_back({"+ light and emission", true, true});
    }
    for (std::size_t i = 0, n = list.size(); i < n; ++i) {
        Feature exact = list[i];
        exact.name += ", reference";
        exact.quality = {.reference = true};
        list.push_back(exact);
    }
    return list;
}

struct Cost {
    double seconds = 0, seconds_render = 0;
    std::uint64_t bytes = 0, pages = 0, cache_bytes = 0;
};

class PayBench {
public:
    explicit PayBench(const BenchOptions& options) : options_(options), pool_(/*jobs=*/0) {}

    Result<nlohmann::json> run() {
        const Result<std::vector<BenchCache>> caches = findCaches(options_.data);
        if (!caches) return tl::unexpected(caches.error());
        const BenchCache& cache = caches->front();
        options_.progress("pay: converting " + cache.name);
        const Result<BenchSubject> subject = prepareSubject(cache, options_.scratch / "density", pool_);
        if (!subject) return tl::unexpected(subject.error());
        const Result<BenchDataset> dataset =
            convertCache(cache, options_.scratch / "all", /*max_error=*/0, /*channels=*/{});
        if (!dataset) return tl::unexpected(dataset.error());
        emission_ = emissionChannel(*dataset, cache.channel);

        nlohmann::json json{{"cache", cache.name}, {"channels", printChannels(*dataset)}};
        std::vector<Cost> costs;
        const std::vector<Feature> list = features(!emission_.empty());
        for (const Feature& feature : list) {
            options_.progress(fmt::format("pay: {}", feature.name));
            const Result<Cost> cost = costOf(*subject, *dataset, feature);
            if (!cost) return tl::unexpected(cost.error());
            costs.push_back(*cost);
        }
        // The same picture from a dataset without the other channels: what the mere presence of those costs.
        const Result<Cost> alone = costOf(*subject, subject->dataset, list.front());
        if (!alone) return tl::unexpected(alone.error());
        print(list, costs, *alone);
        for (std::size_t i = 0; i < list.size(); ++i)
            json["features"].push_back(toJson(list[i].name, costs[i]));
        json["absorption_of_a_dataset_of_density_alone"] = toJson(list.front().name, *alone);
        if (emission_.empty()) json["skipped"] = "emission: the cache has no second scalar channel";
        return json;
    }

private:
    nlohmann::json printChannels(const BenchDataset& dataset) const {
        options_.print(
            fmt::format("\nA dataset of {} channels, the framing view:", dataset.footer.channels_size()));
        TextTable table({"channel", "components", "stored MB"});
        nlohmann::json json = nlohmann::json::array();
        for (const ChannelFooter& channel : dataset.footer.channels()) {
            table.add({channel.name(), std::to_string(channel.components()),
                       fmt::format("{:.3f}", double(channel.payload_bytes()) / 1e6)});
            json.push_back({{"name", channel.name()}, {"payload_bytes", channel.payload_bytes()}});
        }
        options_.print(table.text());
        return json;
    }

    RenderRequest requestOf(const BenchSubject& subject, const Feature& feature) const {
        const auto framing = std::find_if(subject.views.begin(), subject.views.end(),
                                          [](const BenchView& view) { return view.name == "framing"; });
        RenderRequest request = brickyard::requestOf(subject, *framing, options_.size, feature.quality);
        request.repeats = 1;
        if (feature.light) {
            Light& light = *request.scene.add_lights();
            for (const double d : {-0.4, 0.3, -0.85}) light.add_direction(d);
            for (int c = 0; c < 3; ++c) light.add_irradiance(10);
        }
        if (feature.emission) {
            Emission& emission = *request.scene.mutable_medium()->mutable_emission();
            emission.set_channel(emission_);
            emission.set_scale(subject.density_scale);
        }
        return request;
    }

    Result<Cost> costOf(const BenchSubject& subject, const BenchDataset& dataset,
                        const Feature& feature) const {
        const RenderRequest request = requestOf(subject, feature);
        Timing total, rays;
        Cost cost;
        for (unsigned i = 0; i < options_.repeats && (i == 0 || total.total() < kEnoughSeconds); ++i) {
            const Result<RenderOutcome> outcome = renderDataset(dataset, request);
            if (!outcome) return tl::unexpected(outcome.error());
            total.add(outcome->seconds_total);
            rays.add(outcome->seconds_render);
            cost.bytes = outcome->streamed.bytes_streamed;
            cost.pages = outcome->streamed.pages_streamed;
            cost.cache_bytes = outcome->cache_bytes;
        }
        cost.seconds = total.median();
        cost.seconds_render = rays.median();
        return cost;
    }

    void print(const std::vector<Feature>& list, const std::vector<Cost>& costs, const Cost& alone) const {
        TextTable table({"feature", "streamed MB", "pages", "cache MB", "seconds", "of them rays once"});
        const auto add = [&](const std::string& name, const Cost& cost) {
            table.add({name, fmt::format("{:.3f}", double(cost.bytes) / 1e6), std::to_string(cost.pages),
                       fmt::format("{:.2f}", double(cost.cache_bytes) / 1e6), cell(cost.seconds),
                       cell(cost.seconds_render)});
        };
        for (std::size_t i = 0; i < list.size(); ++i) add(list[i].name, costs[i]);
        add("absorption, density alone in the dataset", alone);
        options_.print(table.text());
        options_.print(
            fmt::format("  channels that no material reads: {} pages and {} bytes more than without them",
                        std::int64_t(costs.front().pages) - std::int64_t(alone.pages),
                        std::int64_t(costs.front().bytes) - std::int64_t(alone.bytes)));
    }

    static nlohmann::json toJson(const std::string& name, const Cost& cost) {
        return {{"name", name},
                {"bytes_streamed", cost.bytes},
                {"pages_streamed", cost.pages},
                {"cache_bytes", cost.cache_bytes},
                {"seconds", cost.seconds},
                {"seconds_render", cost.seconds_render}};
    }

    const BenchOptions& options_;
    WorkerPool pool_;
    std::string emission_;
};

}  // namespace

Result<nlohmann::json> benchPay(const BenchOptions& options) { return PayBench(options).run(); }

}  // namespace brickyard
