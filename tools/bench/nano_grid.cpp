#include "tools/bench/nano_grid.h"

#include <fmt/format.h>
#include <nanovdb/util/OpenToNanoVDB.h>

#include "tools/bench/source_grid_data.h"

namespace brickyard {

Result<NanoGrid> NanoGrid::create(const SourceGrid& grid) {
    try {
        auto handle = std::make_shared<nanovdb::GridHandle<nanovdb::HostBuffer>>(
            nanovdb::openToNanoVDB(*grid.data().grid));
        NanoGrid nano;
        nano.data_ = handle->grid<float>();
        nano.owner_ = std::move(handle);
        if (!nano.data_)
            return fail(ErrorCode::kUnsupported, "NanoVDB made no float grid; choose another cache");
        return nano;
    } catch (const std::exception& error) {
        return fail(ErrorCode::kUnsupported, fmt::format("NanoVDB refuses the grid: {}", error.what()));
    }
}

}  // namespace brickyard
