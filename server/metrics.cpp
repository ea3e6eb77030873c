#include "server/metrics.h"

#include <dirent.h>
#include <fmt/format.h>
#include <prometheus/counter.h>
#include <prometheus/gauge.h>
#include <prometheus/histogram.h>
#include <prometheus/registry.h>
#include <prometheus/text_serializer.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <fstream>
#include <mutex>

namespace brickyard {
namespace {

using prometheus::BuildCounter;
using prometheus::BuildGauge;
using prometheus::BuildHistogram;

// From a page that is in memory to one that waits for a slow network.
const prometheus::Histogram::BucketBoundaries kSeconds{
    0.0001, 0.00025, 0.0005, 0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 0.5, 1, 2.5, 5, 10};

std::uint64_t residentBytes() {
    std::ifstream in("/proc/self/statm");
    std::uint64_t size = 0, resident = 0;
    in >> size >> resident;
    return resident * std::uint64_t(sysconf(_SC_PAGESIZE));
}

std::uint64_t openDescriptors() {
    // Since Linux 6.2 the folder's size is their number. Reading ten thousand entries takes milliseconds,
    // which the connections of this thread would wait.
    struct stat counted = {};
    if (stat("/proc/self/fd", &counted) == 0 && counted.st_size > 0) return std::uint64_t(counted.st_size);
    DIR* folder = opendir("/proc/self/fd");
    if (folder == nullptr) return 0;
    std::uint64_t count = 0;
    while (readdir(folder) != nullptr) ++count;
    closedir(folder);
    return count - 3;  // ".", ".." and the one that reads
}

double processorSeconds() {
    rusage used{};
    getrusage(RUSAGE_SELF, &used);
    const auto seconds = [](const timeval& time) {
        return double(time.tv_sec) + double(time.tv_usec) * 1e-6;
    };
    return seconds(used.ru_utime) + seconds(used.ru_stime);
}

}  // namespace

struct Metrics::State {
    // Tells one object's counters from those of another one that lay at the same address.
    const std::uint64_t id = [] {
        static std::atomic<std::uint64_t> last{0};
        return ++last;
    }();
    std::mutex reading;  // two who read at once must not both count what is new

    prometheus::Registry registry;

    prometheus::Family<prometheus::Counter>& requests = BuildCounter()
                                                            .Name("brickyard_http_requests_total")
                                                            .Help("Answered, by route and status")
                                                            .Register(registry);
    prometheus::Histogram& request_seconds =
        BuildHistogram()
            .Name("brickyard_http_request_seconds")
            .Help("From the request's last byte to the answer's last byte in the socket")
            .Register(registry)
            .Add({}, kSeconds);
    prometheus::Family<prometheus::Gauge>& connections =
        BuildGauge().Name("brickyard_connections").Help("Open now").Register(registry);
    prometheus::Gauge* const open[2] = {&connections.Add({{"kind", "http"}}),
                                        &connections.Add({{"kind", "stream"}})};
    prometheus::Family<prometheus::Counter>& refused = BuildCounter()
                                                           .Name("brickyard_connections_refused_total")
                                                           .Help("Turned away when they connected")
                                                           .Register(registry);
    prometheus::Family<prometheus::Counter>& pages =
        BuildCounter().Name("brickyard_pages_sent_total").Help("Bricks and tree blocks").Register(registry);
    prometheus::Counter* const page[2][2] = {
        {&pages.Add({{"via", "http"}, {"kind", "brick"}}), &pages.Add({{"via", "http"}, {"kind", "block"}})},
        {&pages.Add({{"via", "stream"}, {"kind", "brick"}}),
         &pages.Add({{"via", "stream"}, {"kind", "block"}})}};
    prometheus::Family<prometheus::Counter>& bytes = BuildCounter()
                                                         .Name("brickyard_payload_bytes_sent_total")
                                                         .Help("Of bricks and tree blocks, as stored")
                                                         .Register(registry);
    prometheus::Counter* const payload[2] = {&bytes.Add({{"via", "http"}}), &bytes.Add({{"via", "stream"}})};
    prometheus::Histogram& page_seconds =
        BuildHistogram()
            .Name("brickyard_page_seconds")
            .Help("From a wish to one of its pages being handed to the socket")
            .Register(registry)
            .Add({}, kSeconds);
    prometheus::Histogram& read_seconds = BuildHistogram()
                                              .Name("brickyard_disk_read_seconds")
                                              .Help("Work that may have waited for the disk")
                                              .Register(registry)
                                              .Add({}, kSeconds);
    prometheus::Counter& wishes =
        BuildCounter().Name("brickyard_wishes_total").Help("Wishes received").Register(registry).Add({});
    prometheus::Counter& replaced = BuildCounter()
                                        .Name("brickyard_wishes_replaced_total")
                                        .Help("Wishes that a newer one replaced before they were done")
                                        .Register(registry)
                                        .Add({});
    prometheus::Family<prometheus::Counter>& errors =
        BuildCounter().Name("brickyard_errors_total").Help("By kind").Register(registry);

    // Set when they are read.
    prometheus::Gauge& gauge(const char* name, const char* help) {
        return BuildGauge().Name(name).Help(help).Register(registry).Add({});
    }
    prometheus::Gauge& queued = gauge("brickyard_queued_bytes", "Memory of what is on its way to clients");
    prometheus::Gauge& queue_limit = gauge("brickyard_queue_limit_bytes", "--queue-memory");
    prometheus::Gauge& wish_bytes =
        gauge("brickyard_wish_bytes", "Memory of the wishes that are being answered");
    prometheus::Gauge& wish_limit = gauge("brickyard_wish_limit_bytes", "--wish-memory");
    prometheus::Gauge& cache_bytes = gauge("brickyard_block_cache_bytes", "Memory of cached tree blocks");
    prometheus::Counter& cache_hits = BuildCounter()
                                          .Name("brickyard_block_cache_hits_total")
                                          .Help("Tree blocks found in memory")
                                          .Register(registry)
                                          .Add({});
    prometheus::Counter& cache_misses = BuildCounter()
                                            .Name("brickyard_block_cache_misses_total")
                                            .Help("Tree blocks read from the disk")
                                            .Register(registry)
                                            .Add({});
    prometheus::Gauge& open_frames = gauge("brickyard_open_frames", "Frame files that are open");
    prometheus::Gauge& datasets = gauge("brickyard_datasets", "Datasets offered");
    prometheus::Gauge& frames = gauge("brickyard_frames", "Frames of all datasets");
    prometheus::Gauge& resident = gauge("process_resident_memory_bytes", "Resident memory");
    prometheus::Gauge& descriptors = gauge("process_open_fds", "Open file descriptors");
    prometheus::Gauge& started = gauge("process_start_time_seconds", "Since the Unix epoch");
    prometheus::Counter& processor = BuildCounter()
                                         .Name("process_cpu_seconds_total")
                                         .Help("User and system time")
                                         .Register(registry)
                                         .Add({});
};

Metrics::Metrics() : state_(std::make_unique<State>()) {
    BuildGauge()
        .Name("brickyard_build_info")
        .Help("1")
        .Register(state_->registry)
        .Add({{"version", "0.1.0"}})
        .Set(1);
    state_->started.Set(
        std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count());
    // There from the start: a rate needs a first value.
    for (const char* kind : {"disk", "protocol", "timeout", "refused", "memory"})
        state_->errors.Add({{"kind", kind}});
    for (const char* reason : {"full", "address", "descriptors"}) state_->refused.Add({{"reason", reason}});
}

Metrics::~Metrics() = default;

void Metrics::httpRequest(std::string_view route, unsigned status, double seconds) {
    // Looked up each time: a family locks and hashes, so the common answers are remembered by each thread.
    struct Known {
        std::uint64_t of = 0;
        const void* route = nullptr;
        unsigned status = 0;
        prometheus::Counter* counter = nullptr;
    };
    thread_local Known known;
    if (known.of != state_->id || known.route != route.data() || known.status != status)
        known = {state_->id, route.data(), status,
                 &state_->requests.Add({{"route", std::string(route)}, {"code", std::to_string(status)}})};
    known.counter->Increment();
    state_->request_seconds.Observe(seconds);
}

void Metrics::connectionOpened(Via via) { state_->open[int(via)]->Increment(); }
void Metrics::connectionClosed(Via via) { state_->open[int(via)]->Decrement(); }
void Metrics::connectionRefused(std::string_view reason) {
    state_->refused.Add({{"reason", std::string(reason)}}).Increment();
}

void Metrics::pageSent(Via via, bool is_block, std::uint64_t bytes, double seconds_since_wish) {
    state_->page[int(via)][is_block ? 1 : 0]->Increment();
    state_->payload[int(via)]->Increment(double(bytes));
    if (via == Via::kStream) state_->page_seconds.Observe(seconds_since_wish);
}

void Metrics::wishReceived(bool replaced_another) {
    state_->wishes.Increment();
    if (replaced_another) state_->replaced.Increment();
}

void Metrics::diskRead(double seconds) { state_->read_seconds.Observe(seconds); }
void Metrics::error(std::string_view kind) { state_->errors.Add({{"kind", std::string(kind)}}).Increment(); }

std::string Metrics::text(const Gauges& now) const {
    State& s = *state_;
    const std::lock_guard lock(s.reading);
    s.queued.Set(double(now.queued_bytes));
    s.queue_limit.Set(double(now.queue_limit_bytes));
    s.wish_bytes.Set(double(now.wish_bytes));
    s.wish_limit.Set(double(now.wish_limit_bytes));
    s.cache_bytes.Set(double(now.block_cache_bytes));
    s.cache_hits.Increment(std::max(0.0, double(now.block_cache_hits) - s.cache_hits.Value()));
    s.cache_misses.Increment(std::max(0.0, double(now.block_cache_misses) - s.cache_misses.Value()));
    s.open_frames.Set(double(now.open_frames));
    s.datasets.Set(double(now.datasets));
    s.frames.Set(double(now.frames));
    s.resident.Set(double(residentBytes()));
    s.descriptors.Set(double(openDescriptors()));
    s.processor.Increment(std::max(0.0, processorSeconds() - s.processor.Value()));
    return prometheus::TextSerializer().Serialize(s.registry.Collect());
}

}  // namespace brickyard
