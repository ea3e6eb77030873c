#include "core/manifest_commit.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include <cerrno>
#include <charconv>
#include <cstdio>
#include <optional>

#include "core/dataset.h"
#include "core/folder_lock.h"
#include "core/io_error.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;

Result<void> writeSynced(const fs::path& file, const std::string& text) {
    const Descriptor descriptor(::open(file.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
    if (!descriptor) return ioError("create", file, errno);
    for (std::size_t at = 0; at < text.size();) {
        const ssize_t written = ::write(descriptor.get(), text.data() + at, text.size() - at);
        if (written < 0 && errno == EINTR) continue;
        if (written < 0) return ioError("write", file, errno);
        at += std::size_t(written);
    }
    if (::fsync(descriptor.get()) != 0) return ioError("sync", file, errno);
    return {};
}

// File systems without hard links have one word or another for it.
bool saysNoLinks(int error) {
    return error == EPERM || error == ENOTSUP || error == EOPNOTSUPP || error == ENOSYS || error == EMLINK;
}

fs::path claimName(const fs::path& folder, std::uint64_t generation) {
    return folder / fmt::format("{}{}", kClaimPrefix, generation);
}

std::optional<std::uint64_t> claimedNumber(const std::string& name) {
    const std::string_view prefix(kClaimPrefix);
    if (!name.starts_with(prefix)) return std::nullopt;
    std::uint64_t number = 0;
    const auto parsed = std::from_chars(name.data() + prefix.size(), name.data() + name.size(), number);
    if (parsed.ec != std::errc() || parsed.ptr != name.data() + name.size()) return std::nullopt;
    return number;
}

// 0 where nothing was ever claimed.
std::uint64_t newestClaim(const fs::path& folder) {
    std::uint64_t newest = 0;
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(folder, error))
        if (const auto number = claimedNumber(entry.path().filename())) newest = std::max(newest, *number);
    return newest;
}

// Only the newest is ever needed, and that always: it is what a slow writer finds out by that it is late.
void removeClaimsBelow(const fs::path& folder, std::uint64_t generation) {
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(folder, error))
        if (const auto number = claimedNumber(entry.path().filename()); number && *number < generation)
            ::unlink(entry.path().c_str());
}

// Lets readers see the newest claim. Repeated until it is still the newest afterwards: a slow writer's rename
// may put an older manifest over a newer one, and the last to rename looks last.
Result<void> publishNewest(const fs::path& folder, std::uint64_t published) {
    for (;;) {
        const std::uint64_t newest = newestClaim(folder);
        if (newest <= published) return {};
        const fs::path temporary = folder / fmt::format("{}manifest-{}", kTemporaryPrefix, ownerSuffix());
        if (::link(claimName(folder, newest).c_str(), temporary.c_str()) != 0) {
            if (errno == ENOENT) continue;  // a newer one has come, and this one was removed
            return ioError("link", temporary, errno);
        }
        const int renamed = ::rename(temporary.c_str(), (folder / kManifestName).c_str());
        const int why = errno;
        // Of two names of one file, rename leaves both.
        ::unlink(temporary.c_str());
        if (renamed != 0) return ioError("rename", temporary, why);
        if (auto synced = syncFolder(folder); !synced) return synced;
        published = newest;
    }
}

}  // namespace

Result<void> syncFolder(const fs::path& folder) {
    const Descriptor descriptor(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
    if (!descriptor) return ioError("open", folder, errno);
    // Some file systems cannot sync folders and say so; they have nothing to sync.
    if (::fsync(descriptor.get()) != 0 && errno != EINVAL) return ioError("sync", folder, errno);
    return {};
}

Result<Manifest> readNewestManifest(const fs::path& folder) {
    auto dataset = Dataset::open(folder);
    if (!dataset) return tl::unexpected(dataset.error());
    if (newestClaim(folder) <= dataset->manifest().generation()) return dataset->manifest();
    if (auto published = publishNewest(folder, dataset->manifest().generation()); !published)
        return tl::unexpected(published.error());
    dataset = Dataset::open(folder);
    if (!dataset) return tl::unexpected(dataset.error());
    return dataset->manifest();
}

Result<bool> commitManifest(const fs::path& folder, const Manifest& next) {
    const fs::path temporary = folder / fmt::format("{}manifest-{}", kTemporaryPrefix, ownerSuffix());
    struct Remover {
        const fs::path& path;
        ~Remover() { ::unlink(path.c_str()); }
    } const remover{temporary};
    if (auto written = writeSynced(temporary, printManifest(next)); !written)
        return tl::unexpected(written.error());

    const fs::path claim = claimName(folder, next.generation());
    if (::link(temporary.c_str(), claim.c_str()) != 0) {
        if (errno == EEXIST || errno == ENOENT) return false;
        if (!saysNoLinks(errno)) return ioError("link", claim, errno);
        // Without links only the folder's lock keeps writers apart.
        if (::rename(temporary.c_str(), (folder / kManifestName).c_str()) != 0)
            return ioError("rename", temporary, errno);
        if (auto synced = syncFolder(folder); !synced) return tl::unexpected(synced.error());
        return true;
    }
    // The number may have been free because it is long past.
    if (newestClaim(folder) > next.generation()) {
        ::unlink(claim.c_str());
        return false;
    }
    // From here on the manifest is the dataset's: whoever comes next makes it visible if we do not.
    if (auto published = publishNewest(folder, next.generation() - 1); !published)
        return tl::unexpected(published.error());
    removeClaimsBelow(folder, next.generation());
    return true;
}

}  // namespace brickyard
