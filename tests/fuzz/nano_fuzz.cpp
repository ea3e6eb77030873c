// NanoVDB files. A first byte of 0: the rest is a file. Else the rest is a list of changes to one of several
// sound files, since the fuzzer would take for ever to find a tree: u16 where, in units of 8 bytes, then 8
// bytes that are put there.
#include <nanovdb/util/GridBuilder.h>
#include <nanovdb/util/IO.h>

#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "memory_file.h"
#include "tools/importers/nano_source.h"

using namespace brickyard;

namespace {

template <class Value, class Stored = Value>
nanovdb::GridHandle<> makeGrid(const Value& value) {
    nanovdb::GridBuilder<Value, Stored> builder(Value(0));
    auto accessor = builder.getAccessor();
    for (int i = 0; i < 60; ++i) accessor.setValue(nanovdb::Coord(i % 9, i / 9 % 7, i * 3), value);
    return builder.template getHandle<>(0.5, nanovdb::Vec3d(1, 2, 3), "grid");
}

std::vector<std::string> makeFiles() {
    std::vector<std::string> files;
    const auto add = [&](nanovdb::GridHandle<> grid, nanovdb::io::Codec codec) {
        const MemoryFile file({});
        nanovdb::io::writeGrid(file.path().string(), grid, codec);
        std::ifstream written(file.path(), std::ios::binary);
        files.emplace_back(std::istreambuf_iterator<char>(written), std::istreambuf_iterator<char>());
    };
    for (const auto codec : {nanovdb::io::Codec::NONE, nanovdb::io::Codec::ZIP, nanovdb::io::Codec::BLOSC}) {
        add(makeGrid<float>(2.5f), codec);
        add(makeGrid<float, nanovdb::FpN>(2.5f), codec);
        add(makeGrid<nanovdb::Vec3f>(nanovdb::Vec3f(1, 2, 3)), codec);
        add(makeGrid<std::int32_t>(7), codec);
    }
    return files;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    static const std::vector<std::string> files = makeFiles();
    if (size == 0) return 0;
    std::string bytes;
    if (data[0] == 0) {
        bytes.assign(reinterpret_cast<const char*>(data + 1), size - 1);
    } else {
        bytes = files[(data[0] - 1u) % files.size()];
        for (std::size_t i = 1; i + 10 <= size; i += 10) {
            std::uint16_t where = 0;
            std::memcpy(&where, data + i, sizeof where);
            // Past the end it cuts the file.
            const std::size_t at = std::size_t(where) * 8;
            if (at + 8 <= bytes.size())
                std::memcpy(bytes.data() + at, data + i + 2, 8);
            else if (where % 64 == 63)
                bytes.resize(bytes.size() - at % bytes.size());
        }
    }
    const MemoryFile file(bytes);
    const auto contents = readNanoVdb(file.path(), {});
    if (!contents) {
        if (contents.error().message.find('\n') != std::string::npos) std::abort();
        return 0;
    }
    SampleBlock block;
    for (const auto& field : contents->fields) {
        (void)field->uniformOver(
            {{-(1ll << 32), -(1ll << 32), -(1ll << 32)}, {1ll << 32, 1ll << 32, 1ll << 32}});
        (void)field->uniformOver({{0, 0, 0}, {4096, 4096, 4096}});
        (void)field->read({{-9, -2, -2}, {9, 9, 70}}, block);
        const IndexBox& active = field->info().active_box;
        if (!active.empty())
            (void)field->read({active.begin, {active.begin[0] + 9, active.begin[1] + 9, active.begin[2] + 9}},
                              block);
    }
    return 0;
}
