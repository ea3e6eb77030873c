#include "tools/importers/vdb_notes.h"

#include <fmt/format.h>

#include <optional>
#include <unordered_map>

#include "core/printable_name.h"

namespace brickyard {
namespace {

constexpr std::uint32_t kMaxNameBytes = 1u << 20;

// Types of one size: OpenVDB's reader takes that many bytes whatever the length says, so another length is
// damage.
std::optional<std::uint32_t> fixedSize(const std::string& type) {
    static const std::unordered_map<std::string, std::uint32_t> kSizes{
        {"bool", 1},   {"int32", 4},  {"float", 4},  {"int64", 8},  {"double", 8}, {"vec2i", 8},
        {"vec2s", 8},  {"vec2d", 16}, {"vec3i", 12}, {"vec3s", 12}, {"vec3d", 24}, {"vec4i", 16},
        {"vec4s", 16}, {"vec4d", 32}, {"mat4s", 64}, {"mat4d", 128}};
    const auto found = kSizes.find(type);
    return found == kSizes.end() ? std::nullopt : std::optional(found->second);
}

}  // namespace

Result<std::vector<MetadataEntry>> readVdbNotes(VdbCursor& cursor) {
    std::vector<MetadataEntry> notes;
    std::unordered_map<std::string, std::size_t> places;
    std::uint64_t total = 0;
    const auto count = cursor.number<std::uint32_t>();
    for (std::uint32_t i = 0; i < count && cursor.ok(); ++i) {
        MetadataEntry note;
        note.name = validUtf8(cursor.string(kMaxNameBytes));
        note.type = validUtf8(cursor.string(kMaxNameBytes));
        const auto length = cursor.number<std::uint32_t>();
        if (!cursor.ok()) break;
        if (note.name.empty()) return fail(ErrorCode::kCorrupt, "a metadata entry has no name");
        const auto size = fixedSize(note.type);
        if (size && *size != length)
            return fail(ErrorCode::kCorrupt, fmt::format("metadata '{}' of type {} claims {} bytes",
                                                         printableName(note.name), note.type, length));
        // "__delayedload": where OpenVDB's own reader finds leaves. It does not survive reading there either.
        if (note.type.starts_with("__")) {
            cursor.skip(length);
            continue;
        }
        constexpr std::uint64_t kOverhead = sizeof(MetadataEntry) + 64;
        total += kOverhead + note.name.size() + note.type.size() + length;
        if (total > kMaxVdbNoteBytes)
            return fail(ErrorCode::kUnsupported,
                        fmt::format("metadata take more than {} MiB", kMaxVdbNoteBytes >> 20));
        const auto bytes = cursor.take(length);
        note.value.assign(reinterpret_cast<const char*>(bytes.data()), bytes.size());
        const auto [place, is_new] = places.emplace(note.name, notes.size());
        if (is_new)
            notes.push_back(std::move(note));
        else
            notes[place->second] = std::move(note);
    }
    if (!cursor.ok()) return fail(ErrorCode::kCorrupt, "metadata are cut off");
    return notes;
}

std::uint64_t vdbNoteBytes(const std::vector<MetadataEntry>& notes) {
    std::uint64_t total = 0;
    for (const MetadataEntry& note : notes)
        total += sizeof note + note.name.size() + note.type.size() + note.value.size();
    return total;
}

}  // namespace brickyard
