#include "tools/source_identity.h"

#include <fmt/format.h>
#include <sys/stat.h>

#include <algorithm>
#include <cerrno>

#include "core/io_error.h"
#include "core/printable_name.h"

namespace brickyard {

Result<SourceFile> describeSource(const std::filesystem::path& file) {
    struct stat status{};
    if (::stat(file.c_str(), &status) != 0) return ioError("open", file, errno);
    // A folder changes whenever something is put into it; nothing of it is read.
    if (!S_ISREG(status.st_mode))
        return fail(ErrorCode::kInvalid, fmt::format("{}: not a file; give files to convert", file.string()));
    SourceFile source;
    source.set_name(validUtf8(file.filename().string()));
    source.set_bytes(std::uint64_t(status.st_size));
    source.set_modified_ns(std::int64_t(status.st_mtim.tv_sec) * 1'000'000'000 + status.st_mtim.tv_nsec);
    return source;
}

std::string sourceKey(const SourceFile& source) {
    return fmt::format("{} {} {}", source.name(), source.bytes(), source.modified_ns());
}

std::vector<std::string> sourceKeys(const std::vector<std::filesystem::path>& files) {
    std::vector<std::string> keys;
    for (const auto& file : files) {
        const auto source = describeSource(file);
        keys.push_back(source ? sourceKey(*source) : source.error().message);
    }
    std::sort(keys.begin(), keys.end());
    return keys;
}

}  // namespace brickyard
