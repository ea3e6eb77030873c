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
    // What marchNano wants: a nanovdb::NanoGrid<float>.
    const void* data() const { return data_; }

private:
    std::shared_ptr<const void> owner_;
    const void* data_ = nullptr;
};

}  // namespace brickyard
