#include "vdb_comparison.h"

#include <fmt/format.h>
#include <openvdb/openvdb.h>

#include <algorithm>
#include <map>
#include <random>
#include <sstream>

#include "core/printable_name.h"
#include "tools/importers/openvdb_source.h"
#include "tools/importers/vdb_source.h"

namespace brickyard {
namespace {

std::string shown(const IndexBox& box) {
    return fmt::format("[{} {} {}, {} {} {})", box.begin[0], box.begin[1], box.begin[2], box.end[0],
                       box.end[1], box.end[2]);
}

class Comparison {
public:
    Comparison(std::vector<std::string>& found, const ComparisonEffort& effort)
        : found_(found), effort_(effort) {}

    void compareFields(const FieldSource& ours, const FieldSource& theirs) {
        name_ = printableName(theirs.info().name);
        ours_ = &ours;
        theirs_ = &theirs;
        SampleBlock block;
        expect(bool(ours.read({{0, 0, 0}, {1, 1, 1}}, block)), "cannot be read");
        compareInfo(ours.info(), theirs.info());

        std::mt19937_64 random(7);
        const IndexBox& active = theirs.info().active_box;
        const IndexBox around = active.empty() ? IndexBox{{-40, -40, -40}, {40, 40, 40}} : active;
        const auto pick = [&](std::int64_t begin, std::int64_t end) {
            return begin + std::int64_t(random() % std::uint64_t(std::max<std::int64_t>(end - begin, 1)));
        };
        for (int round = 0; round < effort_.random_boxes && found_.size() < 20; ++round) {
            IndexBox box;
            const std::int64_t edge = std::int64_t(1) << random() % 6;
            for (std::size_t a = 0; a < 3; ++a) {
                // Most around the active voxels, some at its corners, where far voxels are.
                box.begin[a] = round % 4 == 0
                                   ? (random() % 2 ? around.begin[a] : around.end[a] - 1) - pick(0, 9)
                               : round % 4 == 1 ? pick(around.begin[a] - 4200, around.end[a] + 4200)
                                                : pick(around.begin[a] - 20, around.end[a] + 20);
                box.end[a] = box.begin[a] + 1 + pick(0, edge);
            }
            compareBox(box);
            // Larger ones, which only topology answers.
            const std::int64_t grown = std::int64_t(1) << random() % 33;
            for (std::size_t a = 0; a < 3; ++a) box.end[a] += pick(0, grown);
            compareUniform(box);
        }
        constexpr std::int64_t kEdge = 64;
        int boxes = 0;
        for (std::int64_t z = active.begin[2]; z < active.end[2] && boxes < effort_.most_boxes; z += kEdge)
            for (std::int64_t y = active.begin[1]; y < active.end[1] && boxes < effort_.most_boxes;
                 y += kEdge)
                for (std::int64_t x = active.begin[0]; x < active.end[0] && boxes < effort_.most_boxes;
                     x += kEdge, ++boxes) {
                    const IndexBox box{{x, y, z}, {x + kEdge, y + kEdge, z + kEdge}};
                    if (found_.size() < 20) compareBox(box);
                }
    }

private:
    void expect(bool holds, const std::string& what) {
        if (!holds) found_.push_back(fmt::format("'{}': {}", name_, what));
    }

    void compareInfo(const ChannelInfo& ours, const ChannelInfo& theirs) {
        expect(ours.name == theirs.name, "named " + ours.name);
        expect(ours.type == theirs.type && ours.components == theirs.components, "type");
        expect(ours.background == theirs.background, "background");
        expect(ours.index_to_world == theirs.index_to_world, "transform");
        expect(ours.active_voxels == theirs.active_voxels,
               fmt::format("{} active voxels, not {}", ours.active_voxels, theirs.active_voxels));
        expect(ours.active_box == theirs.active_box,
               "active box " + shown(ours.active_box) + ", not " + shown(theirs.active_box));
        expect(ours.grid_class == theirs.grid_class, "class " + ours.grid_class);
        expect(ours.vector_type == theirs.vector_type, "vector type " + ours.vector_type);
        expect(ours.saved_as_half == theirs.saved_as_half, "half");
    }

    void compareUniform(const IndexBox& box) {
        const auto one = ours_->uniformOver(box), reference = theirs_->uniformOver(box);
        if (!one) return;  // allowed: not known without reading samples
        expect(reference && one->value == reference->value && one->active == reference->active,
               "uniform over " + shown(box));
    }

    void compareBox(const IndexBox& box) {
        compareUniform(box);
        SampleBlock block, reference;
        const auto read = ours_->read(box, block);
        expect(bool(read), read ? "" : read.error().message);
        expect(bool(theirs_->read(box, reference)), "their read");
        expect(block.active == reference.active, "active states in " + shown(box));
        expect(block.values == reference.values, "values in " + shown(box));
    }

    std::vector<std::string>& found_;
    const ComparisonEffort& effort_;
    std::string name_;
    const FieldSource *ours_ = nullptr, *theirs_ = nullptr;
};

void compareMetadata(const std::vector<MetadataEntry>& ours, const openvdb::MetaMap& theirs,
                     const std::string& of, std::vector<std::string>& found) {
    std::map<std::string, std::string> notes, reference;
    for (const MetadataEntry& note : ours) notes[note.name] = note.type + " " + note.value;
    for (auto it = theirs.beginMeta(); it != theirs.endMeta(); ++it) {
        std::ostringstream bytes;
        it->second->write(bytes);  // the length first
        reference[it->first] = it->second->typeName() + " " + bytes.str().substr(4);
    }
    if (notes != reference)
        found.push_back(
            fmt::format("metadata of {}: {} entries, {} expected", of, notes.size(), reference.size()));
}

}  // namespace

std::vector<std::string> differencesToOpenVdb(const std::filesystem::path& file, ComparisonEffort effort) {
    std::vector<std::string> found;
    const auto ours = openVdb(file, {});
    const auto theirs = readVdb(file, {});
    if (!ours || !theirs) {
        if (bool(ours) != bool(theirs))
            found.push_back(ours ? "theirs refuses: " + theirs.error().message : ours.error().message);
        return found;
    }
    if (ours->names != theirs->names) found.push_back("names");
    const auto reasons = [](const std::vector<SkippedGrid>& skipped) {
        std::vector<std::string> lines;
        for (const SkippedGrid& grid : skipped) lines.push_back(grid.name + ": " + grid.reason);
        return lines;
    };
    if (reasons(ours->skipped) != reasons(theirs->skipped)) found.push_back("what is left out");
    if (ours->fields.size() != theirs->fields.size()) {
        found.push_back("number of fields");
        return found;
    }
    Comparison comparison(found, effort);
    openvdb::io::File input(file.string());
    input.setCopyMaxBytes(0);
    input.open(/*delayLoad=*/false);
    compareMetadata(ours->metadata, *input.getMetadata(), "the file", found);
    for (std::size_t i = 0; i < ours->fields.size(); ++i) {
        comparison.compareFields(*ours->fields[i], *theirs->fields[i]);
        // Several grids of one name are told apart by numbers that are the file's, not ours.
        const ChannelInfo& info = ours->fields[i]->info();
        if (info.name.find('[') == std::string::npos && input.hasGrid(info.name))
            compareMetadata(info.metadata, *input.readGridMetadata(info.name), info.name, found);
    }
    return found;
}

}  // namespace brickyard
