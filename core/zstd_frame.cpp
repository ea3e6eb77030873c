#include "core/zstd_frame.h"

#include <zstd.h>

#include <memory>
#include <new>

namespace brickyard {
namespace {

// Level 9 gains 1.5 % on simulation caches and costs 3 to 9 times the time. (DESIGN.md, section 13.)
constexpr int kLevel = 1;
// Nothing stored is larger than 2^25 bytes, so no honest frame wants a larger window.
constexpr int kWindowLogMax = 25;

struct FreeContext {
    void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
    void operator()(ZSTD_DCtx* context) const { ZSTD_freeDCtx(context); }
};

ZSTD_CCtx* compressor() {
    thread_local const std::unique_ptr<ZSTD_CCtx, FreeContext> context{ZSTD_createCCtx()};
    if (!context) throw std::bad_alloc();
    return context.get();
}

ZSTD_DCtx* decompressor() {
    thread_local const std::unique_ptr<ZSTD_DCtx, FreeContext> context = [] {
        std::unique_ptr<ZSTD_DCtx, FreeContext> made{ZSTD_createDCtx()};
        if (made) ZSTD_DCtx_setParameter(made.get(), ZSTD_d_windowLogMax, kWindowLogMax);
        return made;
    }();
    if (!context) throw std::bad_alloc();
    return context.get();
}

}  // namespace

std::size_t appendZstdFrame(std::span<const std::byte> bytes, std::vector<std::byte>& out) {
    const std::size_t at = out.size();
    out.resize(at + ZSTD_compressBound(bytes.size()));
    const std::size_t size =
        ZSTD_compressCCtx(compressor(), out.data() + at, out.size() - at, bytes.data(), bytes.size(), kLevel);
    // The buffer has room for the worst case, so running out of memory is all that is left to fail.
    if (ZSTD_isError(size)) throw std::bad_alloc();
    out.resize(at + size);
    return size;
}

bool readZstdFrame(std::span<const std::byte> frame, std::span<std::byte> out) {
    if (ZSTD_getFrameContentSize(frame.data(), frame.size()) != out.size()) return false;
    // One frame and nothing behind it: the function below would also take several.
    if (ZSTD_findFrameCompressedSize(frame.data(), frame.size()) != frame.size()) return false;
    return ZSTD_decompressDCtx(decompressor(), out.data(), out.size(), frame.data(), frame.size()) ==
           out.size();
}

}  // namespace brickyard
