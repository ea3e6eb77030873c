#include "tools/importers/vdb_metadata.h"

#include <openvdb/openvdb.h>

#include <sstream>

#include "core/printable_name.h"

namespace brickyard {
namespace {

using openvdb::GridBase;

std::string serialize(const openvdb::Metadata& value) {
    std::ostringstream stream(std::ios::binary);
    value.write(stream);
    // The length comes first, and is ours to know.
    return stream.str().substr(std::min(stream.str().size(), sizeof(openvdb::Index32)));
}

MetadataEntry entryOf(const std::string& name, const openvdb::Metadata& value) {
    return {validUtf8(name), validUtf8(value.typeName()), serialize(value)};
}

// What the writer of a file finds out by itself.
bool isStatistic(const std::string& name) {
    return name == GridBase::META_FILE_BBOX_MIN || name == GridBase::META_FILE_BBOX_MAX ||
           name == GridBase::META_FILE_COMPRESSION || name == GridBase::META_FILE_MEM_BYTES ||
           name == GridBase::META_FILE_VOXEL_COUNT || name == GridBase::META_FILE_DELAYED_LOAD;
}

// What an export sets from the channel itself; empty where it sets nothing of that name.
std::string regenerated(const std::string& name, const ChannelInfo& channel) {
    if (name == GridBase::META_GRID_NAME) return channel.name;
    if (name == GridBase::META_GRID_CLASS) return channel.grid_class == "unknown" ? "" : channel.grid_class;
    if (name == GridBase::META_VECTOR_TYPE)
        return channel.vector_type == "invariant" ? "" : channel.vector_type;
    return {};
}

bool isRegenerated(const std::string& name, const openvdb::Metadata& value, const ChannelInfo& channel) {
    if (name == GridBase::META_SAVE_HALF_FLOAT) return value.typeName() == "bool" && channel.saved_as_half;
    if (name != GridBase::META_GRID_NAME && name != GridBase::META_GRID_CLASS &&
        name != GridBase::META_VECTOR_TYPE)
        return false;
    const std::string text = regenerated(name, channel);
    return value.typeName() == "string" && !text.empty() && serialize(value) == text;
}

openvdb::Metadata::Ptr parse(const MetadataEntry& entry) {
    const auto size = openvdb::Index32(entry.value.size());
    const std::string bytes = std::string(reinterpret_cast<const char*>(&size), sizeof size) + entry.value;
    const auto readAs = [&](openvdb::Metadata::Ptr value) {
        std::istringstream stream(bytes, std::ios::binary);
        value->read(stream);
        return value;
    };
    if (openvdb::Metadata::isRegisteredType(entry.type)) try {
            return readAs(openvdb::Metadata::createMetadata(entry.type));
        } catch (const openvdb::Exception&) {
            // Of another size than its type has.
        }
    return readAs(std::make_shared<openvdb::UnknownMetadata>(entry.type));
}

}  // namespace

std::vector<MetadataEntry> fileMetadata(const openvdb::MetaMap& metadata) {
    std::vector<MetadataEntry> entries;
    for (auto it = metadata.beginMeta(); it != metadata.endMeta(); ++it)
        entries.push_back(entryOf(it->first, *it->second));
    return entries;
}

std::vector<MetadataEntry> gridMetadata(const GridBase& grid, const ChannelInfo& channel) {
    std::vector<MetadataEntry> entries;
    for (auto it = grid.beginMeta(); it != grid.endMeta(); ++it)
        if (!isStatistic(it->first) && !isRegenerated(it->first, *it->second, channel))
            entries.push_back(entryOf(it->first, *it->second));
    // A grid without a name says so by saying nothing, and its channel is called something.
    if (!grid[GridBase::META_GRID_NAME] && channel.name.starts_with("unnamed"))
        entries.push_back({GridBase::META_GRID_NAME, "string", ""});
    return entries;
}

void restoreMetadata(const std::vector<MetadataEntry>& entries, openvdb::MetaMap& metadata) {
    for (const MetadataEntry& entry : entries) {
        if (entry.name.empty()) continue;  // OpenVDB allows none
        metadata.removeMeta(entry.name);
        metadata.insertMeta(entry.name, *parse(entry));
    }
}

}  // namespace brickyard
