// Raw dumps, as simulation tutorials and scanners write them: samples and nothing else, or behind a header
// that is skipped. Also gzip-compressed.
#pragma once

#include "tools/importers/input_file.h"

namespace brickyard {

// One channel, named and scaled as the options say. A voxel is a cell: sample (0, 0, 0) is the centre of the
// first, half a voxel from the world's origin. Errors: kNotFound, kIo; kInvalid (a layout that is none, or
// that the file's size contradicts: both sizes are told); kCorrupt.
Result<InputContents> readRaw(const std::filesystem::path& file, const InputOptions& options);

}  // namespace brickyard
