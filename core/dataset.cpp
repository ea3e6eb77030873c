#include "core/dataset.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <google/protobuf/util/json_util.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>

#include "core/brick_shape.h"
#include "core/io_error.h"

namespace brickyard {
namespace {

constexpr std::uint64_t kMaxManifestBytes = 256u << 20;
constexpr std::size_t kChecksumDigits = 16;

Result<std::string> readWhole(const std::filesystem::path& file) {
    const int descriptor = ::open(file.c_str(), O_RDONLY | O_CLOEXEC);
    if (descriptor < 0) return ioError("open", file, errno);
    struct Closer {
        int descriptor;
        ~Closer() { ::close(descriptor); }
    } const closer{descriptor};
    struct stat status{};
    if (::fstat(descriptor, &status) != 0) return ioError("stat", file, errno);
    if (!S_ISREG(status.st_mode) || std::uint64_t(status.st_size) > kMaxManifestBytes)
        return fail(ErrorCode::kCorrupt,
                    fmt::format("{}: not a manifest ({} bytes); convert this dataset again", file.string(),
                                status.st_size));
    std::string text(std::size_t(status.st_size), '\0');
    std::size_t at = 0;
    while (at < text.size()) {
        const ssize_t got = ::read(descriptor, text.data() + at, text.size() - at);
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) return ioError("read", file, errno);
        if (got == 0) break;
        at += std::size_t(got);
    }
    text.resize(at);
    return text;
}

std::string textChecksum(const std::string& text) {
    return fmt::format("{:016x}", checksum(std::as_bytes(std::span(text))));
}

// Where the checksum's digits stand in the text, npos where there are none. It is the last field that is
// printed; a channel may be called "checksum" too.
std::size_t findDigits(const std::string& text, const std::string& digits) {
    const std::size_t key = text.rfind("\"checksum\"");
    return key == std::string::npos ? key : text.find(digits, key);
}

bool staysInside(const std::string& file) {
    const std::filesystem::path path(file);
    return !file.empty() && path.is_relative() && file.find('\0') == std::string::npos &&
           path.has_filename() && std::none_of(path.begin(), path.end(), [](const auto& part) {
               return part == ".." || part == ".";
           });
}

std::string manifestFault(const Manifest& manifest) {
    if (manifest.format_major() == 0) return "it has no format version";
    if (!isBrickEdge(manifest.brick_edge())) return fmt::format("a brick edge of {}", manifest.brick_edge());
    for (int i = 0; i < manifest.frames_size(); ++i) {
        const FrameEntry& entry = manifest.frames(i);
        if (i > 0 && manifest.frames(i - 1).frame() >= entry.frame())
            return fmt::format("frame {} does not rise above the one before it", entry.frame());
        if (!staysInside(entry.file()))
            return fmt::format("frame {} has a file outside the dataset, '{}'", entry.frame(), entry.file());
        for (const ChannelSummary& channel : entry.channels()) {
            const int corners = channel.active_min_size();
            if (channel.index_to_world_size() != 16 || (corners != 0 && corners != 3) ||
                channel.active_max_size() != corners)
                return fmt::format("frame {}, channel '{}' has a malformed transform or box", entry.frame(),
                                   channel.name());
        }
    }
    return {};
}

}  // namespace

Result<Manifest> parseManifest(const std::string& json, const std::string& where) {
    // A newer minor version may add fields.
    google::protobuf::util::JsonParseOptions options;
    options.ignore_unknown_fields = true;
    Manifest manifest;
    const auto corrupt = [&](const std::string& what) {
        return fail(ErrorCode::kCorrupt, fmt::format("{}: {}; convert this dataset again", where, what));
    };
    if (const auto parsed = google::protobuf::util::JsonStringToMessage(json, &manifest, options);
        !parsed.ok()) {
        // The parser quotes the place below the complaint; a message is one line.
        std::string why(parsed.message());
        return corrupt("not a manifest: " + why.substr(0, why.find('\n')));
    }
    if (manifest.format_major() > kFormatMajor)
        return fail(
            ErrorCode::kTooNew,
            fmt::format("{}: format version {}.{} is newer than this program's {}.{}; update the program",
                        where, manifest.format_major(), manifest.format_minor(), kFormatMajor, kFormatMinor));
    if (!manifest.checksum().empty()) {
        std::string text = json;
        const std::size_t digits = findDigits(text, manifest.checksum());
        if (manifest.checksum().size() != kChecksumDigits || digits == std::string::npos)
            return corrupt("the checksum is malformed");
        text.replace(digits, kChecksumDigits, kChecksumDigits, '0');
        if (textChecksum(text) != manifest.checksum())
            return corrupt("the manifest fails its checksum (remove the line \"checksum\" if you edited it)");
    }
    if (auto fault = manifestFault(manifest); !fault.empty())
        return corrupt("the manifest is wrong: " + fault);
    return manifest;
}

std::string printManifest(const Manifest& manifest) {
    google::protobuf::util::JsonPrintOptions options;
    options.add_whitespace = true;
    options.always_print_primitive_fields = true;
    options.preserve_proto_field_names = true;

    const std::string zeros(kChecksumDigits, '0');
    Manifest unsigned_manifest = manifest;
    unsigned_manifest.set_checksum(zeros);
    std::string text;
    [[maybe_unused]] const auto printed =
        google::protobuf::util::MessageToJsonString(unsigned_manifest, &text, options);
    // Fails only on strings that are not UTF-8, which no caller puts there.
    assert(printed.ok());

    const std::size_t digits = findDigits(text, zeros);
    assert(digits != std::string::npos);
    text.replace(digits, kChecksumDigits, textChecksum(text));
    return text;
}

Result<Dataset> Dataset::open(const std::filesystem::path& folder) {
    std::error_code error;
    if (!std::filesystem::exists(folder, error))
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: no such dataset; check the path", folder.string()));
    if (!std::filesystem::is_directory(folder, error))
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: not a dataset folder; give the folder that `brickyard convert` wrote",
                                folder.string()));
    const std::filesystem::path file = folder / kManifestName;
    auto text = readWhole(file);
    if (!text && text.error().code == ErrorCode::kNotFound)
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: not a dataset: it has no {}", folder.string(), kManifestName));
    if (!text) return tl::unexpected(text.error());
    auto manifest = parseManifest(*text, file.string());
    if (!manifest) return tl::unexpected(manifest.error());
    Dataset dataset;
    dataset.folder_ = folder;
    dataset.manifest_ = std::move(*manifest);
    return dataset;
}

const FrameEntry* Dataset::findFrame(std::uint32_t frame) const {
    const auto& frames = manifest_.frames();
    const auto found = std::lower_bound(
        frames.begin(), frames.end(), frame,
        [](const FrameEntry& entry, std::uint32_t number) { return entry.frame() < number; });
    return found != frames.end() && found->frame() == frame ? &*found : nullptr;
}

Result<std::shared_ptr<const BrickStore>> Dataset::openFrame(std::uint32_t frame) const {
    const FrameEntry* entry = findFrame(frame);
    if (!entry)
        return fail(ErrorCode::kNotFound, fmt::format("{}: has no frame {}; it has {}", folder_.string(),
                                                      frame, describeFrames(manifest_)));
    auto store = BrickStore::open(folder_ / entry->file());
    if (!store) return store;
    if ((*store)->fileBytes() != entry->file_bytes() || (*store)->footerChecksum() != entry->footer_xxh64())
        return fail(ErrorCode::kCorrupt,
                    fmt::format("{}: not the file that the manifest means for frame {}; convert "
                                "this frame again",
                                (*store)->path().string(), frame));
    if ((*store)->footer().brick_edge() != manifest_.brick_edge())
        return fail(
            ErrorCode::kCorrupt,
            fmt::format("{}: bricks of edge {}, but the manifest says {}; convert this "
                        "frame again",
                        (*store)->path().string(), (*store)->footer().brick_edge(), manifest_.brick_edge()));
    return store;
}

std::string describeFrames(const Manifest& manifest) {
    if (manifest.frames().empty()) return "none";
    std::string text;
    for (int first = 0; first < manifest.frames_size();) {
        int last = first;
        while (last + 1 < manifest.frames_size() &&
               manifest.frames(last + 1).frame() == manifest.frames(last).frame() + 1)
            ++last;
        if (!text.empty()) text += ", ";
        text += first == last
                    ? fmt::format("{}", manifest.frames(first).frame())
                    : fmt::format("{}-{}", manifest.frames(first).frame(), manifest.frames(last).frame());
        first = last + 1;
    }
    return text;
}

}  // namespace brickyard
