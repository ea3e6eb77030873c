// How long reading all values of a .vdb file takes, and how much memory: by our own reader or by libopenvdb.
//   vdb_read_bench make FILE [EDGE]             writes a cloud of EDGE^3 voxels (default 1024)
//   vdb_read_bench ours|openvdb FILE [THREADS]  reads all boxes as a converter asks for them
#include <fmt/format.h>
#include <openvdb/openvdb.h>
#include <sys/resource.h>

#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <string>
#include <thread>

#include "tools/importers/openvdb_source.h"
#include "tools/importers/vdb_source.h"

using namespace brickyard;

namespace {

using Clock = std::chrono::steady_clock;
double since(Clock::time_point begin) { return std::chrono::duration<double>(Clock::now() - begin).count(); }

int makeCloud(const std::string& file, int edge) {
    openvdb::initialize();
    auto grid = openvdb::FloatGrid::create();
    grid->setName("density");
    grid->setGridClass(openvdb::GRID_FOG_VOLUME);
    for (int z = 0; z < edge; z += 8)
        for (int y = 0; y < edge; y += 8)
            for (int x = 0; x < edge; x += 8) {
                const double lump =
                    std::sin(0.021 * x) + std::cos(0.017 * y) + std::sin(0.013 * z + 0.01 * x);
                if (lump < 0.5) continue;
                auto* leaf = grid->tree().touchLeaf(openvdb::Coord(x, y, z));
                for (openvdb::Index n = 0; n < 512; ++n) {
                    const openvdb::Coord at = leaf->offsetToGlobalCoord(n);
                    const double value =
                        lump + 0.2 * std::sin(0.9 * at.x()) * std::sin(1.1 * at.y() + 0.3 * at.z());
                    if (value > 0.45) leaf->setValueOn(n, float(value));
                }
            }
    openvdb::io::File(file).write({grid});
    fmt::print("{} leaves, {} active voxels\n", grid->tree().leafCount(), grid->activeVoxelCount());
    return 0;
}

template <class Fields>
void readAll(const Fields& fields, int threads) {
    std::uint64_t boxes_read = 0;
    for (const auto& field : fields) {
        SampleBlock first;
        if (!field->read({{0, 0, 0}, {1, 1, 1}}, first)) std::abort();
        const IndexBox active = field->info().active_box;
        std::vector<IndexBox> boxes;
        constexpr std::int64_t kStep = 128, kEdge = 143;
        for (std::int64_t z = active.begin[2] & ~(kStep - 1); z < active.end[2]; z += kStep)
            for (std::int64_t y = active.begin[1] & ~(kStep - 1); y < active.end[1]; y += kStep)
                for (std::int64_t x = active.begin[0] & ~(kStep - 1); x < active.end[0]; x += kStep)
                    boxes.push_back({{x, y, z}, {x + kEdge, y + kEdge, z + kEdge}});
        std::atomic<std::size_t> next = 0;
        std::vector<std::thread> workers;
        for (int t = 0; t < threads; ++t)
            workers.emplace_back([&] {
                SampleBlock block;
                for (std::size_t i; (i = next++) < boxes.size();)
                    if (!field->uniformOver(boxes[i]) && !field->read(boxes[i], block)) std::abort();
            });
        for (std::thread& worker : workers) worker.join();
        boxes_read += boxes.size();
        field->release();
    }
    fmt::print("{} boxes, ", boxes_read);
}

}  // namespace

int main(int argc, char** argv) {
    if (argc < 3) return 2;
    const std::string what = argv[1], file = argv[2];
    const int number = argc > 3 ? std::atoi(argv[3]) : 0, threads = std::max(number, 1);
    if (what == "make") return makeCloud(file, number > 0 ? number : 1024);
    const auto begin = Clock::now();
    if (what == "ours") {
        const auto contents = openVdb(file, {});
        if (!contents) return 1;
        readAll(contents->fields, threads);
    } else {
        const auto contents = readVdb(file, {});
        if (!contents) return 1;
        fmt::print("loaded after {:.3f} s, ", since(begin));
        readAll(contents->fields, threads);
    }
    rusage usage{};
    ::getrusage(RUSAGE_SELF, &usage);
    fmt::print("{} threads: {:.3f} s, {} MiB at most\n", threads, since(begin), usage.ru_maxrss >> 10);
    return 0;
}
