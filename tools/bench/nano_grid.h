// A grid in NanoVDB's layout. Immutable; any thread.
#pragma once

#include <memory>

#include "core/result.h"
#include "tools/bench/source_grid.h"

namespace brickyard {

class NanoGrid {
public:
    // Errors: kUnsupported (NanoVDB refuses the grid).
    static Result<NanoGrid> create(const SourceGrid& grid);
    // What marchNano wants: a nanovdb::NanoGrid<float>, and the cells that have density at one of their
    // corners as a nanovdb::NanoGrid<nanovdb::ValueMask>, a cell being named by its lowest corner.
    const void* density() const { return density_.get(); }
    const void* cells() const { return cells_.get(); }

private:
    std::shared_ptr<const void> density_, cells_;
};

}  // namespace brickyard
