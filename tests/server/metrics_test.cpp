// The text that Prometheus reads.
#include "server/metrics.h"

#include <gmock/gmock.h>

#include <map>
#include <memory>
#include <regex>
#include <set>
#include <sstream>
#include <thread>
#include <vector>

namespace brickyard {
namespace {

// Samples by name and labels, as written. Fails on a line that is none of the text format.
std::map<std::string, double> samplesOf(const std::string& text) {
    static const std::regex kSample(
        R"(([a-zA-Z_:][a-zA-Z0-9_:]*(\{([a-zA-Z_][a-zA-Z0-9_]*="([^"\\\n]|\\.)*",?)*\})?) ([-+0-9.eE]+|\+Inf|NaN))");
    static const std::regex kComment(
        R"(# (HELP [a-zA-Z_:][a-zA-Z0-9_:]* .*|TYPE \S+ (counter|gauge|histogram)))");
    std::map<std::string, double> samples;
    std::set<std::string> types;
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) {
        std::smatch match;
        if (line.starts_with("#")) {
            EXPECT_TRUE(std::regex_match(line, kComment)) << line;
            if (line.starts_with("# TYPE ")) EXPECT_TRUE(types.insert(line).second) << "told twice: " << line;
            continue;
        }
        if (!std::regex_match(line, match, kSample)) {
            ADD_FAILURE() << "no sample: " << line;
            continue;
        }
        EXPECT_TRUE(samples.emplace(match[1], std::strtod(match[5].str().c_str(), nullptr)).second)
            << "told twice: " << line;
    }
    EXPECT_TRUE(text.ends_with("\n"));
    return samples;
}

TEST(Metrics, AreTheTextThatPrometheusReads) {
    Metrics metrics;
    metrics.httpRequest("page", 200, 0.001);
    metrics.connectionOpened(Via::kStream);
    metrics.connectionRefused("full");
    metrics.pageSent(Via::kStream, false, 1000, 0.01);
    metrics.wishReceived(true);
    metrics.diskRead(0.1);
    metrics.error("protocol");
    Metrics::Gauges now;
    now.queued_bytes = 7;
    const auto samples = samplesOf(metrics.text(now));
    EXPECT_GT(samples.size(), 60u);
    EXPECT_EQ(samples.at("brickyard_queued_bytes"), 7);
    EXPECT_EQ(samples.at("brickyard_wishes_replaced_total"), 1);
    EXPECT_EQ(samples.at(R"(brickyard_errors_total{kind="protocol"})"), 1);
    EXPECT_EQ(samples.at(R"(brickyard_connections{kind="stream"})"), 1);
    EXPECT_EQ(samples.at(R"(brickyard_connections{kind="http"})"), 0);
    EXPECT_EQ(samples.at(R"(brickyard_payload_bytes_sent_total{via="stream"})"), 1000);
    EXPECT_EQ(samples.at(R"(brickyard_page_seconds_bucket{le="+Inf"})"), 1);
    EXPECT_GT(samples.at("process_open_fds"), 2);
}

TEST(Metrics, CountersOnlyRise) {
    Metrics metrics;
    std::map<std::string, double> before;
    for (int round = 0; round < 5; ++round) {
        metrics.httpRequest("page", 200, 0.001);
        metrics.httpRequest("page", 404, 0.001);
        metrics.connectionOpened(Via::kHttp);
        if (round % 2 == 1) metrics.connectionClosed(Via::kHttp);
        metrics.pageSent(Via::kHttp, true, 10, 0);
        Metrics::Gauges now;
        // A cache that begins anew counts from nothing.
        now.block_cache_hits = std::uint64_t(round == 3 ? 0 : 10 * round);
        const auto after = samplesOf(metrics.text(now));
        for (const auto& [name, value] : before)
            if (name.find("_total") != std::string::npos || name.find("_bucket") != std::string::npos ||
                name.find("_count") != std::string::npos)
                EXPECT_GE(after.at(name), value) << name;
        before = after;
    }
    EXPECT_EQ(before.at(R"(brickyard_http_requests_total{code="404",route="page"})"), 5);
    EXPECT_EQ(before.at("brickyard_block_cache_hits_total"), 40);
}

// One thread may count for one server after another.
TEST(Metrics, AreNotMistakenForOnesThatLayAtTheSamePlace) {
    alignas(Metrics) std::byte place[sizeof(Metrics)];
    for (int i = 0; i < 3; ++i) {
        auto* metrics = new (place) Metrics;
        metrics->httpRequest("page", 200, 0.001);
        EXPECT_EQ(
            samplesOf(metrics->text({})).at(R"(brickyard_http_requests_total{code="200",route="page"})"), 1);
        metrics->~Metrics();
    }
}

TEST(Metrics, CountOnceWhoeverReads) {
    Metrics metrics;
    std::vector<std::thread> threads;
    for (int t = 0; t < 4; ++t)
        threads.emplace_back([&] {
            Metrics::Gauges now;
            now.block_cache_hits = 1000;
            for (int i = 0; i < 20; ++i) metrics.text(now);
        });
    for (std::thread& thread : threads) thread.join();
    Metrics::Gauges now;
    now.block_cache_hits = 1000;
    EXPECT_EQ(samplesOf(metrics.text(now)).at("brickyard_block_cache_hits_total"), 1000);
}

}  // namespace
}  // namespace brickyard
