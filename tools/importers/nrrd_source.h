// NRRD volumes: header and data in one file (.nrrd) or in two (.nhdr beside its data).
#pragma once

#include "tools/importers/input_file.h"

namespace brickyard {

// One channel, called `options.name`. Compressed data and text are unpacked into an unlinked temporary file.
// A data file must stand in the header's folder or below it. Errors: kNotFound, kIo; kInvalid, kUnsupported,
// kTooNew: the header's field and what is wrong with it; kCorrupt: data that are not what the header says.
Result<InputContents> readNrrd(const std::filesystem::path& file, const InputOptions& options);

}  // namespace brickyard
