// NanoVDB files (.nvdb) as fields: float, double, int16, int32, int64, uint32, bool, mask, Vec3f and Vec3d
// grids, and floats quantised as Fp4, Fp8, Fp16 and FpN; several grids and segments, uncompressed, ZIP or
// Blosc. No NanoVDB header is seen from here.
#pragma once

#include "tools/importers/input_file.h"

namespace brickyard {

// Every node is checked when the file is opened, and copied as far as it says where others are: nothing that
// the file says is followed later without a check. Values stay in the file. Other kinds of grid are skipped
// with their reason. Errors: kNotFound, kIo, kCorrupt, kTooNew, kUnsupported; kInvalid (a transform that is
// singular or not finite; more nodes than `memory_bytes` holds).
Result<InputContents> readNanoVdb(const std::filesystem::path& file, const InputOptions& options);

}  // namespace brickyard
