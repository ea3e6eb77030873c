#include "tools/importers/vdb_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <cstring>
#include <set>
#include <utility>

#include "core/printable_name.h"
#include "tools/importers/vdb_file.h"
#include "tools/importers/vdb_grid_field.h"
#include "tools/importers/vdb_notes.h"

namespace brickyard {
namespace {

constexpr std::uint64_t kDefaultCacheBytes = std::uint64_t(64) << 20;

// More than the faces of some boxes of 150^3 samples gains nothing.
std::uint64_t cacheBytes(std::uint64_t memory_bytes) {
    return memory_bytes == 0 ? kDefaultCacheBytes : std::min(memory_bytes / 2, kDefaultCacheBytes);
}

// OpenVDB's words, which it compares without regard to case and blanks around them.
std::string wordOf(const std::string& text, std::initializer_list<const char*> words, const char* otherwise) {
    std::string word = text;
    const auto is_blank = [](char c) { return c == ' ' || (c >= '\t' && c <= '\r'); };
    word.erase(word.begin(), std::ranges::find_if_not(word, is_blank));
    while (!word.empty() && is_blank(word.back())) word.pop_back();
    std::ranges::transform(word, word.begin(),
                           [](char c) { return c >= 'A' && c <= 'Z' ? char(c + 32) : c; });
    for (const char* known : words)
        if (word == known) return word;
    return otherwise;
}

// Where the "[2]" begins that a file adds to a name it has already, or npos. A grid's own name may end so,
// too.
std::size_t findCopyNumber(const std::string& name) {
    const std::size_t open = name.empty() || name.back() != ']' ? std::string::npos : name.rfind('[');
    const bool number = open != std::string::npos && open + 2 < name.size() &&
                        name.find_first_not_of("0123456789", open + 1) == name.size() - 1;
    return number ? open : std::string::npos;
}

class Opener {
public:
    Opener(const VdbFile& file, const InputOptions& options)
        : file_(file),
          options_(options),
          cache_(std::make_shared<VdbLeafCache>(cacheBytes(options.memory_bytes))),
          grids_(file.grids()) {}

    Result<InputContents> open() {
        contents_.metadata = file_.metadata();
        if (!file_.hasOffsets())
            if (auto found = passStream(); !found) return tl::unexpected(found.error());
        // In the order of their names, those of one name as they come.
        std::vector<std::pair<std::string, std::size_t>> sorted;
        for (std::size_t i = 0; i < grids_.size(); ++i) sorted.emplace_back(grids_[i].name(), i);
        std::ranges::sort(sorted);
        for (const auto& [sort_name, number] : sorted) {
            const VdbGridEntry& grid = grids_[number];
            const std::string name = channelName(grid);
            contents_.names.push_back(name);
            if (!options_.channels.empty() &&
                std::ranges::find(options_.channels, name) == options_.channels.end())
                continue;
            if (auto opened = openGrid(grid, name); !opened) return tl::unexpected(opened.error());
        }
        return std::move(contents_);
    }

private:
    static std::string shown(const std::string& name) {
        return fmt::format("grid '{}'", printableName(name));
    }
    tl::unexpected<Error> failed(ErrorCode code, const std::string& name, const std::string& what) const {
        return fail(code, fmt::format("{}: {} {}", file_.bytes().path(), shown(name), what));
    }

    // Finds the grids of a file without offsets: one begins where the tree of the one before it ends.
    Result<void> passStream() {
        std::uint64_t at = file_.gridsBegin();
        for (std::size_t i = 1; i <= file_.gridCount(); ++i) {
            auto grid = file_.readEntry(at, i);
            if (!grid) return tl::unexpected(grid.error());
            const std::string where = shown(grid->shownName());
            const auto head = file_.readHead(*grid, where);
            if (!head) return tl::unexpected(head.error());
            const auto type = findVdbValueType(grid->valueType());
            // A tree that we cannot pass hides all grids behind it, and a frustum's numbers are not passed
            // either.
            if (!type || !head->linear)
                return failed(ErrorCode::kUnsupported, grid->shownName(), "cannot be passed over");
            at = head->tree_begin;
            if (grid->parent.empty()) {
                VdbCoding coding{*type, head->compression, head->flag("is_saved_as_half_float")};
                auto tree = VdbTree::build(file_.bytes(), at, grid->end, coding,
                                           fmt::format("{}: {}", file_.bytes().path(), where));
                if (!tree) return tl::unexpected(tree.error());
                at = tree->end();
            }
            grid->end = at;
            grids_.push_back(std::move(*grid));
        }
        return {};
    }

    // What OpenVDB calls the grid, but the first of several grids of one name has the plain name.
    std::string channelName(const VdbGridEntry& grid) {
        const std::string grid_name = grid.shownName();
        std::string name = grid_name, copy;
        if (const std::size_t number = findCopyNumber(grid_name); number != std::string::npos) {
            const auto head = file_.readHead(grid, shown(grid_name));
            if (head && head->text("name") != grid_name) {
                name = grid_name.substr(0, number);
                if (grid_name.substr(number) != "[0]") copy = grid_name.substr(number);
            }
        }
        const std::string base = (name.empty() ? "unnamed" : validUtf8(name)) + copy;
        name = base;
        for (int n = 1; !used_names_.insert(name).second; ++n) name = fmt::format("{}[{}]", base, n);
        return name;
    }

    // The tree that the grid has, its own or another's.
    Result<VdbTreePlace> placeTree(const VdbGridEntry& grid, const VdbGridHead& head,
                                   const VdbValueType& type, const std::string& name) const {
        VdbTreePlace place;
        place.where = fmt::format("{}: {}", file_.bytes().path(), shown(name));
        const VdbGridEntry* owner = &grid;
        VdbGridHead parent_head;
        if (!grid.parent.empty()) {
            const auto parent = std::ranges::find(grids_, grid.parent, &VdbGridEntry::unique_name);
            if (parent == grids_.end() || !parent->parent.empty() || parent->type != grid.type)
                return failed(
                    ErrorCode::kCorrupt, name,
                    fmt::format("shares the tree of '{}', which has none of its type; write the file again",
                                printableName(grid.parent)));
            owner = &*parent;
            auto read = file_.readHead(*parent, shown(parent->shownName()));
            if (!read) return tl::unexpected(read.error());
            // A frustum's map is not passed, so where its tree begins is not known.
            if (!read->linear)
                return failed(ErrorCode::kUnsupported, name,
                              "shares the tree of a grid with a frustum transform");
            parent_head = std::move(*read);
        }
        const VdbGridHead& owner_head = owner == &grid ? head : parent_head;
        place.begin = owner_head.tree_begin;
        place.end = owner->end;
        place.coding.type = type;
        place.coding.compression = owner_head.compression;
        place.coding.half = owner_head.flag("is_saved_as_half_float");
        return place;
    }

    Result<void> openGrid(const VdbGridEntry& grid, const std::string& name) {
        const std::string value_type = grid.valueType();
        const auto type = findVdbValueType(value_type);
        if (!type) {
            contents_.skipped.push_back(
                {name, value_type.empty() ? fmt::format("has a tree of type {}, which cannot be converted",
                                                        printableName(grid.type))
                                          : fmt::format("has values of type {}, which cannot be converted",
                                                        printableName(value_type))});
            return {};
        }
        auto head = file_.readHead(grid, shown(name));
        if (!head) return tl::unexpected(head.error());
        if (!head->linear) {
            contents_.skipped.push_back(
                {name,
                 "has a frustum transform, which cannot be converted; resample it onto a linear transform"});
            return {};
        }
        const auto transform = Affine::fromColumns(head->index_to_world);
        if (!transform)
            return failed(ErrorCode::kInvalid, name,
                          fmt::format("has an unusable transform ({}); give it an invertible, finite one",
                                      transform.error().message));
        note_bytes_ += head->metadata_bytes;
        if (note_bytes_ > kMaxVdbNoteBytes)
            return failed(ErrorCode::kUnsupported, name,
                          fmt::format("brings the file's metadata to more than {} MiB; leave some out",
                                      kMaxVdbNoteBytes >> 20));
        auto place = placeTree(grid, *head, *type, name);
        if (!place) return tl::unexpected(place.error());
        auto background = readBackground(*place);
        if (!background) return tl::unexpected(background.error());

        ChannelInfo info;
        info.name = name;
        info.type = type->component;
        info.components = type->components;
        info.background = std::move(*background);
        info.index_to_world = *transform;
        info.grid_class = wordOf(head->text("class"), {"level set", "fog volume", "staggered"}, "unknown");
        info.saved_as_half = head->flag("is_saved_as_half_float");
        if (type->components == 3)
            info.vector_type = wordOf(
                head->text("vector_type"),
                {"covariant", "covariant normalize", "contravariant relative", "contravariant absolute"},
                "invariant");
        if (type->mask) info.source_type = "mask";
        info.metadata = std::move(head->metadata);
        // A grid without a name says so by an empty note, and its channel is called something.
        const auto named = std::ranges::any_of(
            info.metadata, [](const MetadataEntry& entry) { return entry.name == "name"; });
        if (!named && name.starts_with("unnamed")) info.metadata.push_back({"name", "string", ""});
        contents_.fields.push_back(std::make_unique<VdbGridField>(file_.sharedBytes(), std::move(*place),
                                                                  std::move(info), cache_,
                                                                  std::uint32_t(contents_.fields.size())));
        return {};
    }

    // The value behind the tree's first number.
    Result<std::vector<ValueBits>> readBackground(const VdbTreePlace& place) const {
        const VdbValueType& type = place.coding.type;
        VdbCursor cursor(file_.bytes(), place.begin, place.end, /*piece_bytes=*/64);
        cursor.skip(4);
        const auto value = cursor.take(type.bytes());
        if (cursor.error()) return tl::unexpected(*cursor.error());
        if (value.empty())
            return fail(ErrorCode::kCorrupt,
                        fmt::format("{}: its tree is cut off or damaged, at byte {}; write the "
                                    "file again",
                                    place.where, place.begin));
        VdbCoding coding = place.coding;
        coding.setBackground(value);
        std::vector<ValueBits> bits(std::size_t(type.components), 0);
        for (std::size_t c = 0; c < bits.size(); ++c)
            std::memcpy(&bits[c], coding.background.data() + c * sampleBytes(type.component),
                        sampleBytes(type.component));
        return bits;
    }

    const VdbFile& file_;
    const InputOptions& options_;
    const std::shared_ptr<VdbLeafCache> cache_;
    std::vector<VdbGridEntry> grids_;
    std::set<std::string> used_names_;
    std::uint64_t note_bytes_ = 0;
    InputContents contents_;
};

}  // namespace

Result<InputContents> openVdb(const std::filesystem::path& path, const InputOptions& options) {
    const auto file = VdbFile::open(path);
    if (!file) return tl::unexpected(file.error());
    if (file->version() < 222)
        return fail(ErrorCode::kUnsupported,
                    fmt::format("{}: OpenVDB file version {} stores nodes another way", path.string(),
                                file->version()));
    return Opener(*file, options).open();
}

}  // namespace brickyard
