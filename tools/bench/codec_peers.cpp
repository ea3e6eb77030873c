#include "tools/bench/codec_peers.h"

#include <blosc.h>
#include <zfp.h>
#include <zstd.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstring>

namespace brickyard {
namespace {

struct CloseZfp {
    void operator()(zfp_stream* stream) const { zfp_stream_close(stream); }
    void operator()(zfp_field* field) const { zfp_field_free(field); }
    void operator()(bitstream* bits) const { stream_close(bits); }
};

class ZfpCodec final : public SampleCodec {
public:
    ZfpCodec(const CodecShape& shape, std::optional<int> exponent, bool last_face)
        : shape_(shape),
          edge_(std::size_t(shape.edge_samples)),
          coded_(last_face ? edge_ : edge_ - 1),
          stream_(zfp_stream_open(nullptr)) {
        if (exponent)
            zfp_stream_set_accuracy(stream_.get(), std::ldexp(1.0, *exponent));
        else
            zfp_stream_set_reversible(stream_.get());
    }

    // The components' streams one behind the other, each with its length in front.
    void encode(std::span<const float> values, std::vector<std::byte>& out) const override {
        out.clear();
        for (std::size_t c = 0; c < std::size_t(shape_.components); ++c) {
            // zfp reads values through a pointer that could also write.
            const auto field = fieldOf(const_cast<float*>(values.data()) + c * edge_ * edge_ * edge_);
            buffer_.resize(zfp_stream_maximum_size(stream_.get(), field.get()));
            const auto bits = open(buffer_.data(), buffer_.size());
            const auto size = std::uint32_t(zfp_compress(stream_.get(), field.get()));
            const std::size_t at = out.size();
            out.resize(at + sizeof size + size);
            std::memcpy(out.data() + at, &size, sizeof size);
            std::memcpy(out.data() + at + sizeof size, buffer_.data(), size);
        }
    }

    bool decode(std::span<const std::byte> bytes, std::span<float> out) const override {
        for (std::size_t c = 0; c < std::size_t(shape_.components); ++c) {
            std::uint32_t size = 0;
            std::memcpy(&size, bytes.data(), sizeof size);
            // zfp reads whole words.
            buffer_.assign(size + sizeof(std::uint64_t), std::byte{0});
            std::memcpy(buffer_.data(), bytes.data() + sizeof size, size);
            const auto bits = open(buffer_.data(), buffer_.size());
            const auto field = fieldOf(out.data() + c * edge_ * edge_ * edge_);
            if (zfp_decompress(stream_.get(), field.get()) == 0) return false;
            bytes = bytes.subspan(sizeof size + size);
        }
        return true;
    }

    std::size_t codedSamples() const override {
        return coded_ * coded_ * coded_ * std::size_t(shape_.components);
    }

private:
    std::unique_ptr<zfp_field, CloseZfp> fieldOf(float* values) const {
        std::unique_ptr<zfp_field, CloseZfp> field(
            zfp_field_3d(values, zfp_type_float, coded_, coded_, coded_));
        zfp_field_set_stride_3d(field.get(), 1, std::ptrdiff_t(edge_), std::ptrdiff_t(edge_ * edge_));
        return field;
    }
    std::unique_ptr<bitstream, CloseZfp> open(std::byte* bytes, std::size_t size) const {
        std::unique_ptr<bitstream, CloseZfp> bits(stream_open(bytes, size));
        zfp_stream_set_bit_stream(stream_.get(), bits.get());
        zfp_stream_rewind(stream_.get());
        return bits;
    }

    CodecShape shape_;
    std::size_t edge_, coded_;
    std::unique_ptr<zfp_stream, CloseZfp> stream_;
    mutable std::vector<std::byte> buffer_;  // kept: to allocate it is none of zfp's work
};

// Floats as they are, or as words of a grid, for codecs that know bytes alone.
class WordCodec : public SampleCodec {
public:
    WordCodec(const CodecShape& shape, std::optional<WordGrid> grid) : shape_(shape), grid_(grid) {}

    void encode(std::span<const float> values, std::vector<std::byte>& out) const override {
        if (!grid_)
            pack(std::as_bytes(values), out);
        else if (grid_->narrow)
            packWords<std::uint16_t>(values, out);
        else
            packWords<std::uint32_t>(values, out);
    }
    bool decode(std::span<const std::byte> bytes, std::span<float> out) const override {
        if (!grid_) return unpack(bytes, std::as_writable_bytes(out));
        return grid_->narrow ? unpackWords<std::uint16_t>(bytes, out)
                             : unpackWords<std::uint32_t>(bytes, out);
    }
    std::size_t codedSamples() const override { return shape_.samples(); }

protected:
    std::size_t wordBytes() const { return grid_ && grid_->narrow ? 2 : 4; }

private:
    virtual void pack(std::span<const std::byte> bytes, std::vector<std::byte>& out) const = 0;
    virtual bool unpack(std::span<const std::byte> packed, std::span<std::byte> out) const = 0;

    template <class Word>
    void packWords(std::span<const float> values, std::vector<std::byte>& out) const {
        words_.resize(values.size() * sizeof(Word));
        Word* const words = reinterpret_cast<Word*>(words_.data());
        const double first = grid_->first, scale = 1 / grid_->step;
        for (std::size_t i = 0; i < values.size(); ++i)
            words[i] = Word(std::uint32_t((double(values[i]) - first) * scale + 0.5));
        pack(words_, out);
    }
    template <class Word>
    bool unpackWords(std::span<const std::byte> bytes, std::span<float> out) const {
        words_.resize(out.size() * sizeof(Word));
        if (!unpack(bytes, words_)) return false;
        const Word* const words = reinterpret_cast<const Word*>(words_.data());
        for (std::size_t i = 0; i < out.size(); ++i)
            out[i] = float(grid_->first + grid_->step * double(words[i]));
        return true;
    }

    CodecShape shape_;
    std::optional<WordGrid> grid_;
    mutable std::vector<std::byte> words_;
};

class BloscCodec final : public WordCodec {
public:
    BloscCodec(const CodecShape& shape, std::optional<WordGrid> grid, std::string compressor, int level)
        : WordCodec(shape, grid), compressor_(std::move(compressor)), level_(level) {}

private:
    void pack(std::span<const std::byte> bytes, std::vector<std::byte>& out) const override {
        out.resize(bytes.size() + BLOSC_MAX_OVERHEAD);
        const int size =
            blosc_compress_ctx(level_, BLOSC_SHUFFLE, wordBytes(), bytes.size(), bytes.data(), out.data(),
                               out.size(), compressor_.c_str(), /*blocksize=*/0, /*numinternalthreads=*/1);
        out.resize(std::size_t(std::max(size, 0)));
    }
    bool unpack(std::span<const std::byte> packed, std::span<std::byte> out) const override {
        return blosc_decompress_ctx(packed.data(), out.data(), out.size(), /*numinternalthreads=*/1) ==
               int(out.size());
    }

    std::string compressor_;
    int level_;
};

struct FreeZstd {
    void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
    void operator()(ZSTD_DCtx* context) const { ZSTD_freeDCtx(context); }
};

class ZstdCodec final : public WordCodec {
public:
    ZstdCodec(const CodecShape& shape, std::optional<WordGrid> grid, int level)
        : WordCodec(shape, grid), level_(level), packer_(ZSTD_createCCtx()), unpacker_(ZSTD_createDCtx()) {}

private:
    void pack(std::span<const std::byte> bytes, std::vector<std::byte>& out) const override {
        out.resize(ZSTD_compressBound(bytes.size()));
        const std::size_t size =
            ZSTD_compressCCtx(packer_.get(), out.data(), out.size(), bytes.data(), bytes.size(), level_);
        out.resize(ZSTD_isError(size) ? 0 : size);
    }
    bool unpack(std::span<const std::byte> packed, std::span<std::byte> out) const override {
        return ZSTD_decompressDCtx(unpacker_.get(), out.data(), out.size(), packed.data(), packed.size()) ==
               out.size();
    }

    int level_;
    std::unique_ptr<ZSTD_CCtx, FreeZstd> packer_;
    std::unique_ptr<ZSTD_DCtx, FreeZstd> unpacker_;
};

}  // namespace

std::unique_ptr<SampleCodec> makeZfpCodec(const CodecShape& shape, std::optional<int> tolerance_exponent,
                                          bool last_face) {
    return std::make_unique<ZfpCodec>(shape, tolerance_exponent, last_face);
}

std::unique_ptr<SampleCodec> makeBloscCodec(const CodecShape& shape, std::optional<WordGrid> grid,
                                            const std::string& compressor, int level) {
    return std::make_unique<BloscCodec>(shape, grid, compressor, level);
}

std::unique_ptr<SampleCodec> makeZstdCodec(const CodecShape& shape, std::optional<WordGrid> grid, int level) {
    return std::make_unique<ZstdCodec>(shape, grid, level);
}

}  // namespace brickyard
