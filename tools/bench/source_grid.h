// A grid of a .vdb file as the peers and the truth read it: OpenVDB itself, nothing of ours. No OpenVDB
// header is seen from here. Immutable; any thread.
#pragma once

#include <filesystem>
#include <memory>
#include <string>

#include "core/result.h"

namespace brickyard {

struct SourceGridData;  // source_grid_data.h

class SourceGrid {
public:
    // `name` is a grid's name in the file, `file` one that `brickyard convert` has accepted. Errors:
    // kNotFound, kIo, kUnsupported (not a float grid).
    static Result<SourceGrid> read(const std::filesystem::path& file, const std::string& name);

    const SourceGridData& data() const { return *data_; }

private:
    std::shared_ptr<const SourceGridData> data_;
};

}  // namespace brickyard
