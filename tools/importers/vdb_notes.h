// Metadata of a .vdb file or of one of its grids ("MetaMap"), as notes that are carried through unread.
#pragma once

#include <string>
#include <vector>

#include "core/field_source.h"
#include "core/result.h"
#include "tools/importers/vdb_bytes.h"

namespace brickyard {

// What all notes of one grid may take: a hostile file has gigabytes of them.
inline constexpr std::uint64_t kMaxVdbNoteBytes = 64u << 20;

// Reads a count and as many notes. Of two of one name the later counts; bytes of a name that are not UTF-8
// become %XX. Errors: kCorrupt (also where the cursor ended: look at its ok() first), kUnsupported (more than
// kMaxVdbNoteBytes), without file and place.
Result<std::vector<MetadataEntry>> readVdbNotes(VdbCursor& cursor);

// The bytes that the notes take in memory.
std::uint64_t vdbNoteBytes(const std::vector<MetadataEntry>& notes);

}  // namespace brickyard
