// `brickyard synth`: large inputs for tests and measurements, made in constant memory, the same for the same
// seed.
#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>

#include "core/io_error.h"
#include "tools/command.h"
#include "tools/progress_line.h"
#include "tools/synth/cloud_field.h"
#include "tools/synth/scan_volume.h"
#include "tools/synth/vdb_stream_writer.h"
#include "tools/worker_pool.h"

namespace brickyard {
namespace {

struct SynthArguments {
    std::string kind, output, compression = "blosc";
    std::int64_t size = 0;
    std::uint64_t voxels = 0, seed = 1;
    std::uint32_t grids = 300;
    unsigned jobs = 0;
};

// A file under a temporary name until it is whole.
class PendingFile {
public:
    explicit PendingFile(std::filesystem::path file) : file_(std::move(file)), temporary_(file_) {
        temporary_ += ".partial";
    }
    ~PendingFile() {
        std::error_code error;
        std::filesystem::remove(temporary_, error);
    }
    const std::filesystem::path& temporary() const { return temporary_; }
    Result<void> commit() {
        std::error_code error;
        std::filesystem::rename(temporary_, file_, error);
        if (error) return ioError("write", file_, error.value());
        return {};
    }

private:
    std::filesystem::path file_, temporary_;
};

Result<std::string> writeScan(const SynthArguments& arguments, WorkerPool& pool) {
    const std::int64_t edge = arguments.size > 0 ? arguments.size : 2048;
    const ScanVolume volume(edge, arguments.seed);
    PendingFile file(arguments.output);
    const int descriptor = ::open(file.temporary().c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (descriptor < 0) return ioError("write", file.temporary(), errno);
    const std::size_t slice = std::size_t(edge * edge);
    // Every worker makes and writes slices of its own: some 8 MiB each, few enough to stay in order on disk.
    std::atomic<std::uint64_t> nonzero{0};
    std::atomic<int> failed{0};
    ProgressLine progress;
    const std::int64_t batch = 4 * std::int64_t(pool.jobs());
    for (std::int64_t z = 0; z < edge && failed == 0; z += batch) {
        pool.run(std::size_t(std::min(batch, edge - z)), [&](std::size_t i) {
            static thread_local std::vector<std::uint16_t> voxels;
            voxels.resize(slice);
            nonzero += volume.slice(z + std::int64_t(i), voxels);
            const std::size_t bytes = slice * sizeof(std::uint16_t);
            const char* const from = reinterpret_cast<const char*>(voxels.data());
            for (std::size_t done = 0; done < bytes && failed == 0;) {
                const auto at = off_t((std::uint64_t(z) + i) * bytes + done);
                const ssize_t put = ::pwrite(descriptor, from + done, bytes - done, at);
                if (put < 0 && errno != EINTR) failed = errno;
                if (put > 0) done += std::size_t(put);
            }
        });
        progress.show("scan", double(z) / double(edge), std::uint64_t(z) * slice * 2);
    }
    progress.clear();
    if (::close(descriptor) != 0 && failed == 0) failed = errno;
    if (failed != 0) return ioError("write", arguments.output, failed);
    if (auto committed = file.commit(); !committed) return tl::unexpected(committed.error());
    return fmt::format("{}^3 voxels, {} active, {} of them not 0; convert it with --raw {}x{}x{}:uint16",
                       edge, std::uint64_t(edge) * slice, nonzero.load(), edge, edge, edge);
}

Result<std::string> writeClouds(const SynthArguments& arguments, WorkerPool& pool) {
    const bool many = arguments.kind == "grids";
    const std::int64_t edge = arguments.size > 0 ? arguments.size : many ? 64 : 65536;
    const std::uint64_t voxels = arguments.voxels > 0 ? arguments.voxels : many ? 20'000 : 1'000'000'000;
    const std::uint32_t grids = many ? arguments.grids : 1;
    PendingFile file(arguments.output);
    ProgressLine progress;
    std::uint32_t done = 0;
    VdbStreamWriter::Options options;
    options.blosc = arguments.compression == "blosc";
    options.grids = grids;
    options.parallel_for = pool.parallelFor();
    options.progress = [&](double part) {
        progress.show("clouds", (double(done) + part) / double(grids), 0);
    };
    auto writer = VdbStreamWriter::create(file.temporary(), std::move(options));
    if (!writer) return tl::unexpected(writer.error());
    VdbGridSummary total;
    std::size_t clouds = 0;
    for (; done < grids; ++done) {
        const CloudField field(edge, voxels, arguments.seed + done);
        const std::string name = many ? fmt::format("density_{:03}", done) : "density";
        const auto written = (*writer)->addGrid(name, 0.1, field);
        if (!written) return tl::unexpected(written.error());
        total.voxels += written->voxels;
        total.leaves += written->leaves;
        clouds += field.cloudCount();
    }
    const auto bytes = (*writer)->finish();
    if (!bytes) return tl::unexpected(bytes.error());
    progress.clear();
    if (auto committed = file.commit(); !committed) return tl::unexpected(committed.error());
    return fmt::format("{} grid{}, {} clouds in {}^3, {} active voxels in {} leaves", grids,
                       grids == 1 ? "" : "s", clouds, edge, total.voxels, total.leaves);
}

int runSynth(const SynthArguments& arguments) {
    const auto started = std::chrono::steady_clock::now();
    WorkerPool pool(arguments.jobs);
    const auto made = arguments.kind == "raw" ? writeScan(arguments, pool) : writeClouds(arguments, pool);
    if (!made) return reportError("synth", made.error());
    std::error_code error;
    const auto seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - started).count();
    fmt::print("{}: {}; {} in {}\n", arguments.output, *made,
               describeBytes(std::filesystem::file_size(arguments.output, error)), describeSeconds(seconds));
    return kExitDone;
}

}  // namespace

void addSynthCommand(CLI::App& app, int& status) {
    const auto arguments = std::make_shared<SynthArguments>();
    CLI::App* command = app.add_subcommand("synth", "Make a large input for tests and measurements");
    command
        ->add_option("kind", arguments->kind,
                     "raw: a scan, uint16, as a raw dump (2048^3, 16 GiB)\n"
                     "cloudscape: clouds scattered over 65536^3, a fog volume as .vdb (10^9 voxels)\n"
                     "grids: a .vdb with many small grids")
        ->required()
        ->check(CLI::IsMember({"raw", "cloudscape", "grids"}))
        ->type_name("KIND");
    command->add_option("output", arguments->output, "The file to write")->required()->type_name("OUT");
    command->add_option("--size", arguments->size, "Voxels along each edge; default 2048, 65536 or 64")
        ->check(CLI::Range(std::int64_t(16), std::int64_t(1) << 20))
        ->type_name("N");
    command
        ->add_option("--voxels", arguments->voxels,
                     "Active voxels that the clouds of a grid have, at least about; default 10^9 or 20000")
        ->check(CLI::Range(std::uint64_t(1), std::uint64_t(1) << 40))
        ->type_name("N");
    command->add_option("--grids", arguments->grids, "How many grids")
        ->check(CLI::Range(1u, 100'000u))
        ->type_name("N")
        ->capture_default_str();
    command->add_option("--compression", arguments->compression, "Of a .vdb: blosc or none")
        ->check(CLI::IsMember({"blosc", "none"}))
        ->type_name("HOW")
        ->capture_default_str();
    command->add_option("--seed", arguments->seed, "The same seed makes the same file")
        ->type_name("N")
        ->capture_default_str();
    command->add_option("--jobs", arguments->jobs, "Threads; default one per processor")
        ->check(CLI::Range(1u, 1024u))
        ->type_name("N");
    command->callback([arguments, &status] { status = runSynth(*arguments); });
}

}  // namespace brickyard
