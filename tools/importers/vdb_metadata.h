// OpenVDB's metadata as our entries and back. Only files that see OpenVDB anyway include this.
#pragma once

#include <openvdb/Grid.h>

#include <vector>

#include "core/field_source.h"

namespace brickyard {

// Every entry of a file's metadata.
std::vector<MetadataEntry> fileMetadata(const openvdb::MetaMap& metadata);

// A grid's metadata but for what a file that is written anew has by itself: the statistics, and name, class,
// vector type and half flag where they say what `channel` says already. Where they say something else (a
// name that another grid has, too; a class that OpenVDB does not know) they are kept.
std::vector<MetadataEntry> gridMetadata(const openvdb::GridBase& grid, const ChannelInfo& channel);

// Puts the entries in, replacing those of their names. Bytes that are no value of their type are kept as
// bytes of that type's name, as OpenVDB keeps types that it does not know.
void restoreMetadata(const std::vector<MetadataEntry>& entries, openvdb::MetaMap& metadata);

}  // namespace brickyard
