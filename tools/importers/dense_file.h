// The samples of a dense volume on disk, fetched slab by slab with few large reads. A slab is a box of
// samples in memory, elements as in the file, x fastest; where components are not interleaved, a whole slab
// of each follows the other. Const members may be called from any thread.
#pragma once

#include <memory>

#include "core/index_box.h"
#include "tools/importers/byte_file.h"
#include "tools/importers/dense_layout.h"

namespace brickyard {

class DenseFile {
public:
    virtual ~DenseFile() = default;

    // Slabs are loaded in pieces, so that several threads can load one: piece i in [0, pieceCount(slab)).
    // REQUIRES: a slab within the extents. Errors: those of ByteFile::readAt.
    virtual std::size_t pieceCount(const IndexBox& slab) const = 0;
    virtual Result<void> loadPiece(const IndexBox& slab, std::size_t piece, std::byte* out) const = 0;
    // Asks the operating system to have this slab in its cache soon.
    virtual void willNeed(const IndexBox& slab) const = 0;
};

// `file` as it lies where x is fastest. Where z is, its samples are put in another order first, once, in an
// unlinked temporary file: boxes of the builder would else touch every page of the file once per row of
// boxes. Holds `memory_bytes` for that at most (at least 1 MiB). REQUIRES: layout.bytes() fits the file.
// Errors: kIo, kCorrupt.
Result<std::unique_ptr<DenseFile>> openDense(ByteFile file, const DenseLayout& layout,
                                             std::uint64_t memory_bytes);

}  // namespace brickyard
