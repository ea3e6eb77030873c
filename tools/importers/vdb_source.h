// .vdb files by our own reader: bounded memory, any thread, and nothing in a file is believed before it is
// checked. No OpenVDB header or library behind it. What it takes is what openvdb_source.h takes, under the
// same names.
#pragma once

#include "tools/importers/input_file.h"

namespace brickyard {

// Reads the outside of the file and what precedes each wanted grid's tree; of a file that was written as a
// stream it also passes over all trees. Damage inside a grid is found by the first use of its field. Errors:
// kNotFound, kIo, kInvalid, kCorrupt, kTooNew; kUnsupported where openvdb_source.h may still read the file
// (versions 220 and 221; streams with grids that are no channels).
Result<InputContents> openVdb(const std::filesystem::path& file, const InputOptions& options);

}  // namespace brickyard
