#include "tools/raw_arguments.h"

#include <fmt/format.h>

#include <charconv>
#include <cmath>

#include "tools/importers/raw_layout.h"

namespace brickyard {
namespace {

// "0.5" or "0.5,0.5,1.25".
Result<std::array<double, 3>> parseVoxelSize(const std::string& text) {
    std::array<double, 3> size{};
    std::size_t count = 0;
    const char* at = text.data();
    const char* const end = at + text.size();
    for (; count < 3; ++at) {
        const auto parsed = std::from_chars(at, end, size[count]);
        if (parsed.ec != std::errc() || !std::isfinite(size[count]) || !(size[count] > 0)) break;
        at = parsed.ptr;
        if (++count == 3 || at == end || *at != ',') break;
    }
    if (at != end || (count != 1 && count != 3))
        return fail(
            ErrorCode::kInvalid,
            fmt::format("'{}' is no voxel size; write one number above 0, or three: 0.5,0.5,1.25", text));
    if (count == 1) size[1] = size[2] = size[0];
    return size;
}

template <class Parse>
auto checkedBy(Parse parse) {
    return [parse](const std::string& text) {
        const auto parsed = parse(text);
        return parsed ? std::string() : parsed.error().message;
    };
}

}  // namespace

void addRawOptions(CLI::App& command, RawArguments& arguments) {
    CLI::Option* raw =
        command
            .add_option("--raw", arguments.layout,
                        "The inputs are raw dumps, laid out so: 128x128x128:uint16 and, as needed,\n"
                        ":z-fastest, :big, :skip=BYTES, :trailing=BYTES. Types: (u)int8/16/32/64,\n"
                        "float16/32/64. May be gzip-compressed")
            ->type_name("LAYOUT")
            ->check(checkedBy([](const std::string& text) { return parseRawLayout(text); }));
    command
        .add_option("--voxel-size", arguments.voxel_size,
                    "Edge of a raw dump's voxels in world units, one number or X,Y,Z; default 1")
        ->type_name("SIZE")
        ->needs(raw)
        ->check(checkedBy(parseVoxelSize));
    command
        .add_option("--name", arguments.name,
                    "Name of the channel of a raw dump or NRRD file; default density")
        ->type_name("NAME");
}

void applyRawOptions(const RawArguments& arguments, InputOptions& options) {
    options.raw = arguments.layout;
    options.name = arguments.name;
    if (!arguments.voxel_size.empty()) options.raw_voxel_size = *parseVoxelSize(arguments.voxel_size);
}

}  // namespace brickyard
