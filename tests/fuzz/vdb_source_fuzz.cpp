// The input as a .vdb file: whatever it says, reading ends, in bounds and in bounded memory. Begin with sound
// files:
//   vdb_source_fuzz NEW_FOLDER tests/data/vdb_seeds
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

#include "tools/importers/vdb_source.h"

using namespace brickyard;

namespace {

void require(bool holds) {
    if (!holds) std::abort();
}

IndexBox boxAt(const Index3& begin, std::int64_t edge) {
    return {begin, {begin[0] + edge, begin[1] + edge, begin[2] + edge}};
}

// Topology and values must agree wherever both have an answer.
void readBox(const FieldSource& field, const IndexBox& box) {
    const auto uniform = field.uniformOver(box);
    SampleBlock block;
    const auto read = field.read(box, block);
    if (!read) return require(read.error().message.find('\n') == std::string::npos);
    if (!uniform) return;
    for (const std::uint8_t active : block.active) require(active == uniform->active);
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static const int file = ::memfd_create("input.vdb", MFD_CLOEXEC);
    require(file >= 0 && ::ftruncate(file, 0) == 0 && ::pwrite(file, data, size, 0) == ssize_t(size));
    const auto contents = openVdb("/proc/self/fd/" + std::to_string(file), {});
    if (!contents) return 0;
    for (const auto& field : contents->fields) {
        constexpr std::int64_t kHalf = std::int64_t(1) << 31;
        (void)field->uniformOver(boxAt({-kHalf, -kHalf, -kHalf}, 2 * kHalf));
        readBox(*field, boxAt({-2, -2, -2}, 16));
        const IndexBox active = field->info().active_box;
        if (active.empty()) continue;
        readBox(*field, boxAt(active.begin, 10));
        readBox(*field, boxAt({active.end[0] - 9, active.end[1] - 9, active.end[2] - 9}, 10));
        (void)field->uniformOver(active);
        field->release();
    }
    return 0;
}
