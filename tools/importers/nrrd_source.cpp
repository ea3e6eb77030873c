#include "tools/importers/nrrd_source.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cstring>

#include "core/printable_name.h"
#include "tools/importers/dense_field.h"
#include "tools/importers/inflate.h"
#include "tools/importers/nrrd_header.h"

namespace brickyard {
namespace {

constexpr std::uint64_t kMaxHeader = 1u << 20;
constexpr std::size_t kChunk = 64u << 10;

// The text of the header; `data_begin` is behind it.
Result<std::string> readHeader(const ByteFile& file, std::uint64_t& data_begin) {
    std::string text(std::size_t(std::min(file.size(), kMaxHeader)), '\0');
    if (auto read = file.readAt(0, std::as_writable_bytes(std::span(text))); !read)
        return tl::unexpected(read.error());
    if (const auto end = findNrrdData(text)) {
        data_begin = *end;
        text.resize(*end);
    } else if (file.size() > kMaxHeader) {
        return fail(ErrorCode::kCorrupt,
                    fmt::format("{}: its header has no end within {} bytes; write the file again",
                                file.path().string(), kMaxHeader));
    } else {
        data_begin = file.size();
    }
    return text;
}

// A name that leads nowhere but to the header's folder and below.
Result<std::filesystem::path> dataPath(const std::filesystem::path& header, const std::string& name) {
    const std::filesystem::path relative(name);
    const bool leaves = relative.is_absolute() || name.empty() || name.find('\0') != std::string::npos ||
                        std::ranges::any_of(relative, [](const auto& part) { return part == ".."; });
    if (leaves)
        return fail(
            ErrorCode::kInvalid,
            fmt::format("{}: its data file '{}' is not in its own folder or below; put both together and "
                        "write the bare name",
                        header.string(), printableName(name)));
    std::error_code error;
    std::filesystem::path path = header.parent_path() / relative;
    // Nor by way of a link.
    const auto folder =
        std::filesystem::weakly_canonical(header.parent_path().empty() ? "." : header.parent_path(), error);
    const auto real = std::filesystem::weakly_canonical(path, error);
    if (error || std::mismatch(folder.begin(), folder.end(), real.begin(), real.end()).first != folder.end())
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: its data file '{}' is a link out of its folder; copy it there",
                                header.string(), printableName(name)));
    return path;
}

Result<std::uint64_t> skipLines(const ByteFile& file, std::uint64_t position, std::uint64_t lines) {
    std::vector<std::byte> chunk;
    while (lines > 0) {
        chunk.resize(std::size_t(std::min<std::uint64_t>(kChunk, file.size() - position)));
        if (chunk.empty())
            return fail(ErrorCode::kCorrupt,
                        fmt::format("{}: has fewer lines than its header skips; write it again",
                                    file.path().string()));
        if (auto read = file.readAt(position, chunk); !read) return tl::unexpected(read.error());
        std::size_t i = 0;
        while (i < chunk.size() && lines > 0) lines -= chunk[i++] == std::byte('\n');
        position += i;
    }
    return position;
}

// Numbers in decimal, between white space or commas, as little-endian elements in a temporary file.
class TextReader {
public:
    TextReader(const ByteFile& file, std::uint64_t position, const DenseLayout& layout)
        : file_(file), position_(position), layout_(layout) {}

    Result<ByteFile> read(std::uint64_t count) {
        // A number and what parts it from the next is two bytes at least.
        if (count > file_.size() - position_)
            return corrupt(
                fmt::format("{} bytes of text cannot hold {} numbers", file_.size() - position_, count));
        auto out = ByteFile::temporary(file_.path(), count * elementBytes(layout_.element));
        if (!out) return tl::unexpected(out.error());
        std::vector<std::byte> elements;
        std::uint64_t done = 0;
        const auto flush = [&] {
            auto written = out->writeAt(out->size(), elements);
            elements.clear();
            return written;
        };
        for (;; ++done) {
            auto word = next();
            if (!word) return tl::unexpected(word.error());
            if (word->empty()) break;
            if (done == count) return corrupt(fmt::format("its text has more than {} numbers", count));
            if (!append(*word, elements))
                return corrupt(fmt::format("number {} of its text, '{}', is no {}", done + 1,
                                           printableName(std::string(*word)), toString(layout_.element)));
            if (elements.size() >= kChunk)
                if (auto written = flush(); !written) return tl::unexpected(written.error());
        }
        if (done < count)
            return corrupt(
                fmt::format("its text has {} numbers, but {} needs {}", done, layout_.describe(), count));
        if (auto written = flush(); !written) return tl::unexpected(written.error());
        return out;
    }

private:
    tl::unexpected<Error> corrupt(const std::string& what) const {
        return fail(ErrorCode::kCorrupt,
                    fmt::format("{}: {}; write the file again", file_.path().string(), what));
    }
    static bool parts(char c) { return c == ' ' || c == ',' || (c >= '\t' && c <= '\r'); }

    // Empty at the end. Valid until the next call.
    Result<std::string_view> next() {
        for (;;) {
            while (at_ < text_.size() && parts(text_[at_])) ++at_;
            std::size_t end = at_;
            while (end < text_.size() && !parts(text_[end])) ++end;
            const bool whole = end < text_.size() || position_ == file_.size();
            if (whole || end - at_ > 400) {
                const std::string_view word = std::string_view(text_).substr(at_, end - at_);
                at_ = end;
                return word;
            }
            text_.erase(0, at_);
            at_ = 0;
            const std::size_t old = text_.size(),
                              more = std::size_t(std::min<std::uint64_t>(kChunk, file_.size() - position_));
            text_.resize(old + more);
            if (auto read = file_.readAt(position_, std::as_writable_bytes(std::span(text_)).subspan(old));
                !read)
                return tl::unexpected(read.error());
            position_ += more;
        }
    }

    template <class Number>
    static bool appendAs(std::string_view word, std::vector<std::byte>& out) {
        if (word.starts_with('+')) word.remove_prefix(1);
        Number value{};
        const auto parsed = std::from_chars(word.data(), word.data() + word.size(), value);
        if (word.empty() || parsed.ec != std::errc() || parsed.ptr != word.data() + word.size()) return false;
        const auto bytes = std::bit_cast<std::array<std::byte, sizeof value>>(value);
        out.insert(out.end(), bytes.begin(), bytes.end());
        return true;
    }
    bool append(std::string_view word, std::vector<std::byte>& out) const {
        switch (layout_.element) {
            case ElementType::kUint8: return appendAs<std::uint8_t>(word, out);
            case ElementType::kInt8: return appendAs<std::int8_t>(word, out);
            case ElementType::kUint16: return appendAs<std::uint16_t>(word, out);
            case ElementType::kInt16: return appendAs<std::int16_t>(word, out);
            case ElementType::kUint32: return appendAs<std::uint32_t>(word, out);
            case ElementType::kInt32: return appendAs<std::int32_t>(word, out);
            case ElementType::kUint64: return appendAs<std::uint64_t>(word, out);
            case ElementType::kInt64: return appendAs<std::int64_t>(word, out);
            case ElementType::kFloat32: return appendAs<float>(word, out);
            case ElementType::kFloat64: return appendAs<double>(word, out);
            case ElementType::kFloat16: return false;
        }
        return false;
    }

    const ByteFile& file_;
    std::uint64_t position_;
    const DenseLayout& layout_;
    std::string text_;
    std::size_t at_ = 0;
};

// The file that holds the samples as they are, and in `layout.offset` where.
Result<ByteFile> openSamples(ByteFile file, const NrrdHeader& header, std::uint64_t data_begin,
                             DenseLayout& layout) {
    const auto begin = skipLines(file, data_begin, header.line_skip);
    if (!begin) return tl::unexpected(begin.error());
    const std::uint64_t bytes = *layout.bytes(),
                        skip = std::uint64_t(std::max<std::int64_t>(header.byte_skip, 0));
    if (skip > std::uint64_t(1) << 61)
        return fail(ErrorCode::kInvalid, fmt::format("{}: its header skips {} bytes, more than any file has",
                                                     file.path().string(), skip));
    if (header.encoding == NrrdEncoding::kGzip) {
        layout.offset = skip;
        return inflateGzip(file, *begin, skip + bytes);
    }
    if (header.encoding == NrrdEncoding::kText) {
        layout.offset = 0;
        if (skip > file.size() - *begin)
            return fail(ErrorCode::kCorrupt,
                        fmt::format("{}: its header skips more than the file has", file.path().string()));
        return TextReader(file, *begin + skip, layout).read(bytes / elementBytes(layout.element));
    }
    const std::uint64_t there = file.size() - *begin;
    if (header.byte_skip < 0 ? there < bytes : there != skip + bytes)
        return fail(ErrorCode::kCorrupt,
                    fmt::format("{}: has {} bytes of data, but {} is {}{}; correct the header, or write "
                                "the file again",
                                file.path().string(), there, layout.describe(), bytes,
                                skip > 0 ? fmt::format(" behind {} skipped", skip) : ""));
    layout.offset = file.size() - bytes;
    return file;
}

}  // namespace

Result<InputContents> readNrrd(const std::filesystem::path& path, const InputOptions& options) {
    auto file = ByteFile::open(path);
    if (!file) return tl::unexpected(file.error());
    std::uint64_t data_begin = 0;
    const auto text = readHeader(*file, data_begin);
    if (!text) return tl::unexpected(text.error());
    const auto header = parseNrrdHeader(*text);
    if (!header)
        return fail(header.error().code, fmt::format("{}: {}", path.string(), header.error().message));
    if (header->data_file) {
        const auto data = dataPath(path, *header->data_file);
        if (!data) return tl::unexpected(data.error());
        file = ByteFile::open(*data);
        if (!file) return tl::unexpected(file.error());
        data_begin = 0;
    }

    ChannelInfo info;
    info.name = options.name.empty() ? "density" : validUtf8(options.name);
    info.index_to_world = header->index_to_world;
    info.vector_type = header->vector_type;
    info.metadata = header->metadata;
    InputContents contents;
    contents.names.push_back(info.name);
    if (!options.channels.empty() && std::ranges::find(options.channels, info.name) == options.channels.end())
        return contents;
    DenseLayout layout = header->layout;
    auto samples = openSamples(std::move(*file), *header, data_begin, layout);
    if (!samples) return tl::unexpected(samples.error());
    auto field = makeDenseField(std::move(*samples), layout, std::move(info), options.memory_bytes);
    if (!field) return tl::unexpected(field.error());
    contents.fields.push_back(std::move(*field));
    return contents;
}

}  // namespace brickyard
