#include "tools/importers/raw_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>

#include "core/printable_name.h"
#include "tools/importers/dense_field.h"
#include "tools/importers/inflate.h"
#include "tools/importers/raw_layout.h"

namespace brickyard {
namespace {

// Both sizes, and the layout that would explain the difference where there is an obvious one.
tl::unexpected<Error> wrongSize(const ByteFile& file, const RawLayout& layout, std::uint64_t samples) {
    const std::uint64_t expected = layout.dense.offset + samples + layout.trailing_bytes;
    std::string parts;
    if (layout.dense.offset > 0) parts += fmt::format(" behind {} skipped", layout.dense.offset);
    if (layout.trailing_bytes > 0) parts += fmt::format(" before {} trailing", layout.trailing_bytes);
    std::string advice = "check extents and type";
    if (file.size() > expected && layout.trailing_bytes == 0)
        advice += fmt::format(
            ", or explain the other {} bytes: :skip={} if a header is in front, :trailing={} if "
            "they are behind",
            file.size() - expected, layout.dense.offset + file.size() - expected, file.size() - expected);
    return fail(ErrorCode::kInvalid,
                fmt::format("{}: has {} bytes, but {} is {} bytes{}, together {}; {}", file.path().string(),
                            file.size(), layout.dense.describe(), samples, parts, expected, advice));
}

}  // namespace

Result<InputContents> readRaw(const std::filesystem::path& path, const InputOptions& options) {
    const auto layout = parseRawLayout(options.raw);
    if (!layout)
        return fail(layout.error().code, fmt::format("{}: {}", path.string(), layout.error().message));
    auto file = ByteFile::open(path);
    if (!file) return tl::unexpected(file.error());
    const std::uint64_t samples = *layout->dense.bytes();
    const std::uint64_t whole = layout->dense.offset + samples + layout->trailing_bytes;
    // A dump may begin like gzip by chance; then its size is right as it is.
    if (file->size() != whole && isGzip(*file)) {
        file = inflateGzip(*file, 0, whole);
        if (!file) return tl::unexpected(file.error());
    }
    if (file->size() != whole) return wrongSize(*file, *layout, samples);

    ChannelInfo info;
    info.name = options.name.empty() ? "density" : validUtf8(options.name);
    std::array<double, 16> columns{};
    for (std::size_t axis = 0; axis < 3; ++axis) {
        const double size = options.raw_voxel_size[axis];
        columns[5 * axis] = size;
        columns[12 + axis] = 0.5 * size;
    }
    columns[15] = 1;
    auto transform = Affine::fromColumns(columns);
    if (!transform)
        return fail(ErrorCode::kInvalid, fmt::format("{}: --voxel-size does not make a transform: {}",
                                                     path.string(), transform.error().message));
    info.index_to_world = *transform;

    InputContents contents;
    contents.names.push_back(info.name);
    if (!options.channels.empty() && std::ranges::find(options.channels, info.name) == options.channels.end())
        return contents;
    auto field = makeDenseField(std::move(*file), layout->dense, std::move(info), options.memory_bytes);
    if (!field) return tl::unexpected(field.error());
    contents.fields.push_back(std::move(*field));
    return contents;
}

}  // namespace brickyard
