#include "server/catalog.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <sys/stat.h>

#include <algorithm>
#include <iterator>
#include <utility>

#include "core/printable_name.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kExtension = ".bricks";
// How old what is known of a manifest may be when someone asks.
constexpr std::chrono::milliseconds kFresh{100};

// The last part of the path as the user wrote it, without the extension that datasets carry.
std::string nameOf(const fs::path& folder) {
    auto path = fs::absolute(folder).lexically_normal();
    if (!path.has_filename()) path = path.parent_path();
    std::string name = path.filename().string();
    if (name.size() > kExtension.size() && name.ends_with(kExtension))
        name.resize(name.size() - kExtension.size());
    return name;
}

bool isInside(const fs::path& file, const fs::path& folder) {
    const auto [end, rest] = std::mismatch(folder.begin(), folder.end(), file.begin(), file.end());
    return end == folder.end();
}

// Whether a dataset lies where its library says, links resolved.
bool isInLibrary(const fs::path& folder) {
    std::error_code error;
    const auto real = fs::canonical(folder, error);
    return !error && isInside(real, fs::canonical(folder.parent_path(), error)) && !error;
}

// A frame file must lie in its dataset's folder, links resolved: whoever may write there must not make us
// read, and send, what lies elsewhere.
Result<void> checkPlace(const Dataset& dataset, const FrameEntry& entry) {
    const auto file = dataset.folder() / entry.file();
    std::error_code error;
    const auto real = fs::canonical(file, error);
    if (error)
        return fail(ErrorCode::kIo, fmt::format("{}: {}; convert frame {} again", file.string(),
                                                error.message(), entry.frame()));
    if (!isInside(real, fs::canonical(dataset.folder(), error)))
        return fail(
            ErrorCode::kInvalid,
            fmt::format("{}: is a link out of its dataset; move the file itself there", file.string()));
    // Opening a pipe would wait for its other end.
    if (!fs::is_regular_file(real, error))
        return fail(ErrorCode::kCorrupt,
                    fmt::format("{}: is not a file; convert frame {} again", file.string(), entry.frame()));
    return {};
}

// Cheap signs that the frame files are those that the manifest means.
Result<void> checkFrames(const Dataset& dataset) {
    for (const FrameEntry& entry : dataset.manifest().frames()) {
        if (auto placed = checkPlace(dataset, entry); !placed) return placed;
        const auto file = dataset.folder() / entry.file();
        std::error_code error;
        const auto bytes = fs::file_size(file, error);
        if (error)
            return fail(ErrorCode::kIo, fmt::format("{}: {}; convert frame {} again", file.string(),
                                                    error.message(), entry.frame()));
        if (bytes != entry.file_bytes())
            return fail(ErrorCode::kCorrupt,
                        fmt::format("{}: has {} bytes where the manifest says {}; convert frame {} again",
                                    file.string(), bytes, entry.file_bytes(), entry.frame()));
    }
    if (dataset.manifest().frames_size() > 0)
        if (auto first = dataset.openFrame(dataset.manifest().frames(0).frame()); !first)
            return tl::unexpected(first.error());
    return {};
}

// On the wire every name is.
std::string notUtf8(const fs::path& folder) {
    return fmt::format("{}: the dataset's name is not UTF-8; rename the folder", validUtf8(folder.string()));
}

bool hasManifest(const fs::path& folder) {
    std::error_code error;
    return fs::exists(folder / kManifestName, error);
}

}  // namespace

Catalog::Catalog(std::size_t max_open_frames, std::uint64_t block_cache_bytes)
    : max_open_frames_(max_open_frames), blocks_(std::make_shared<BlockCache>(block_cache_bytes)) {}

Catalog::Stamp Catalog::stampOf(const fs::path& folder) {
    // Where the manifest cannot be looked at, the stamp is that of nothing.
    Stamp stamp;
    struct stat status = {};
    if (::stat((folder / kManifestName).c_str(), &status) != 0) return stamp;
    stamp.modified = fs::file_time_type(std::chrono::seconds(status.st_mtim.tv_sec) +
                                        std::chrono::nanoseconds(status.st_mtim.tv_nsec));
    stamp.bytes = std::uintmax_t(status.st_size);
    stamp.inode = status.st_ino;
    return stamp;
}

Result<Catalog::Entry> Catalog::openEntry(const fs::path& folder) {
    Entry entry;
    entry.folder = folder;
    entry.stamp = stampOf(folder);
    entry.looked = std::chrono::steady_clock::now();
    auto dataset = Dataset::open(folder);
    if (!dataset) return tl::unexpected(dataset.error());
    if (auto checked = checkFrames(*dataset); !checked) return tl::unexpected(checked.error());
    entry.dataset = std::make_shared<const Dataset>(std::move(*dataset));
    return entry;
}

Result<std::unique_ptr<Catalog>> Catalog::open(const std::vector<fs::path>& paths,
                                               std::size_t max_open_frames, std::uint64_t block_cache_bytes) {
    std::unique_ptr<Catalog> catalog(new Catalog(max_open_frames, block_cache_bytes));
    for (const auto& path : paths) {
        std::error_code error;
        const bool is_library = fs::is_directory(path, error) && !hasManifest(path) &&
                                !nameOf(path / "x").empty() && !path.string().ends_with(kExtension);
        if (is_library) {
            catalog->libraries_.push_back(path);
            continue;
        }
        auto entry = openEntry(path);
        if (!entry) return tl::unexpected(entry.error());
        const std::string name = nameOf(path);
        if (name != validUtf8(name)) return fail(ErrorCode::kInvalid, notUtf8(path));
        const auto [other, is_new] = catalog->entries_.emplace(name, std::move(*entry));
        if (!is_new)
            return fail(ErrorCode::kInvalid,
                        fmt::format("{} and {}: both datasets would be called {}; rename one of the folders",
                                    other->second.folder.string(), path.string(), name));
    }
    for (const auto& library : catalog->libraries_) {
        Changes found;
        catalog->addFromLibrary(library, found);
        // Told with the first refresh: one that is half there is no reason not to serve the others.
        std::move(found.warnings.begin(), found.warnings.end(), std::back_inserter(catalog->early_warnings_));
    }
    return catalog;
}

void Catalog::addFromLibrary(const fs::path& library, Changes& changes) {
    std::error_code error;
    std::vector<fs::path> folders;
    for (fs::directory_iterator at(library, error), end; !error && at != end; at.increment(error)) {
        const auto& folder = at->path();
        std::error_code ignored;
        if (folder.filename().string().ends_with(kExtension) && at->is_directory(ignored) &&
            hasManifest(folder))
            folders.push_back(folder);
    }
    if (error)
        changes.warnings.push_back(
            fmt::format("{}: cannot be listed: {}", library.string(), error.message()));
    std::sort(folders.begin(), folders.end());
    std::erase_if(rejected_, [&](const auto& rejected) {
        return rejected.first.parent_path() == library &&
               !std::binary_search(folders.begin(), folders.end(), rejected.first);
    });
    for (const auto& folder : folders) {
        const std::string name = nameOf(folder);
        const auto known = entries_.find(name);
        if (known != entries_.end() && known->second.folder == folder) continue;
        // Looked at again and again: what copies a dataset here may bring the frames behind the manifest.
        const auto reject = [&](std::string why) {
            const Stamp stamp = stampOf(folder);
            const auto [told, is_new] = rejected_.emplace(folder, stamp);
            if (is_new || told->second != stamp) changes.warnings.push_back(std::move(why));
            told->second = stamp;
        };
        if (name != validUtf8(name)) {
            reject(notUtf8(folder));
            continue;
        }
        if (!isInLibrary(folder)) {
            reject(fmt::format("{}: is a link out of the served folder; name the dataset itself",
                               folder.string()));
            continue;
        }
        if (known != entries_.end()) {
            reject(fmt::format("{} and {}: both datasets would be called {}; rename one of the folders",
                               known->second.folder.string(), folder.string(), name));
            continue;
        }
        auto entry = openEntry(folder);
        if (!entry) {
            reject(entry.error().message);
            continue;
        }
        rejected_.erase(folder);
        entry->from_library = true;
        entries_.emplace(name, std::move(*entry));
        changes.names = true;
    }
}

std::vector<std::string> Catalog::names() const {
    const std::lock_guard lock(mutex_);
    std::vector<std::string> names;
    for (const auto& [name, entry] : entries_)
        if (entry.dataset) names.push_back(name);
    return names;
}

std::string Catalog::describeNames() const {
    std::vector<std::string> names;
    for (const auto& [name, entry] : entries_)
        if (entry.dataset) names.push_back(name);
    return names.empty() ? "none" : fmt::format("{}", fmt::join(names, ", "));
}

// Takes the manifest anew where it is another one now. It is replaced atomically, so a new stamp means a
// whole new manifest; one that cannot be read now (the folder is being exchanged) leaves the old one in place
// until the next question.
void Catalog::look(Entry& entry) const {
    entry.looked = std::chrono::steady_clock::now();
    const Stamp now = stampOf(entry.folder);
    if (now == entry.stamp) return;
    // A folder that became a link out of its library is gone, as far as we are concerned.
    if (now == Stamp{} || (entry.from_library && !isInLibrary(entry.folder))) {
        entry.changed = entry.changed || entry.dataset != nullptr;
        entry.dataset = nullptr;
        entry.stamp = now;
        return;
    }
    auto reopened = Dataset::open(entry.folder);
    if (!reopened) return;
    entry.dataset = std::make_shared<const Dataset>(std::move(*reopened));
    entry.stamp = now;
    entry.changed = true;
}

Result<std::shared_ptr<const Dataset>> Catalog::dataset(const std::string& name) const {
    const std::lock_guard lock(mutex_);
    const auto found = entries_.find(name);
    if (found != entries_.end()) {
        Entry& entry = found->second;
        if (std::chrono::steady_clock::now() - entry.looked > kFresh) look(entry);
        if (entry.dataset) return entry.dataset;
    }
    return fail(ErrorCode::kNotFound, fmt::format("no dataset '{}' here", printableName(name)));
}

std::shared_ptr<const FrameReader> Catalog::openedFrame(const std::string& name, std::uint32_t number) const {
    const std::lock_guard lock(mutex_);
    for (auto open = frames_.begin(); open != frames_.end(); ++open)
        if (open->frame == number && open->name == name) {
            if (open != frames_.begin()) frames_.splice(frames_.begin(), frames_, open);
            return frames_.front().reader;
        }
    return nullptr;
}

Result<ServedFrame> Catalog::frame(const std::string& name, std::optional<std::uint32_t> number) const {
    const auto from = dataset(name);
    if (!from) return tl::unexpected(from.error());
    const Manifest& manifest = (*from)->manifest();
    if (!number && manifest.frames_size() > 0) number = manifest.frames(0).frame();
    const FrameEntry* entry = number ? (*from)->findFrame(*number) : nullptr;
    if (entry == nullptr)
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: no frame {}; there are: {}", name, number.value_or(0),
                                manifest.frames_size() == 0 ? "none yet" : describeFrames(manifest)));
    const auto same = [&](const OpenFrame& open) { return open.frame == *number && open.name == name; };
    {
        const std::lock_guard lock(mutex_);
        if (const auto open = std::find_if(frames_.begin(), frames_.end(), same); open != frames_.end()) {
            if (open->footer_checksum == entry->footer_xxh64()) {
                frames_.splice(frames_.begin(), frames_, open);
                return ServedFrame{*number, open->reader};
            }
            // Converted again: nobody must find the old one.
            frames_.erase(open);
        }
    }
    if (auto placed = checkPlace(**from, *entry); !placed) return tl::unexpected(placed.error());
    // Opened without the lock: a slow disk must not stop those whose frames are open.
    auto store = (*from)->openFrame(*number);
    if (!store) {
        // Perhaps there is no descriptor left for one more; those of frames that nobody reads are free to go.
        const std::lock_guard lock(mutex_);
        while (frames_.size() > 1 && frames_.back().reader.use_count() == 1) frames_.pop_back();
        return tl::unexpected(store.error());
    }
    auto reader = std::make_shared<const FrameReader>(std::move(*store), blocks_);
    const std::lock_guard lock(mutex_);
    // Another thread may have opened it meanwhile.
    frames_.remove_if(same);
    frames_.push_front({name, *number, entry->footer_xxh64(), reader});
    // Whoever still reads from a frame that leaves the list keeps it open.
    if (frames_.size() > max_open_frames_) frames_.pop_back();
    return ServedFrame{*number, reader};
}

Catalog::Changes Catalog::refresh() {
    Changes changes;
    const std::lock_guard lock(mutex_);
    changes.warnings = std::exchange(early_warnings_, {});
    for (auto at = entries_.begin(); at != entries_.end();) {
        auto& [name, entry] = *at;
        look(entry);
        // Also what somebody's question noticed meanwhile.
        if (std::exchange(entry.changed, false)) {
            changes.datasets.push_back(name);
            const bool is_there = entry.dataset != nullptr;
            if (std::exchange(entry.told, is_there) != is_there) changes.names = true;
            // What was converted again, or is gone, is not what is open.
            frames_.remove_if([&](const OpenFrame& open) {
                if (open.name != name) return false;
                const FrameEntry* now = entry.dataset ? entry.dataset->findFrame(open.frame) : nullptr;
                return now == nullptr || now->footer_xxh64() != open.footer_checksum;
            });
        }
        at = entry.from_library && !entry.dataset ? entries_.erase(at) : std::next(at);
    }
    for (const auto& library : libraries_) addFromLibrary(library, changes);
    return changes;
}

Catalog::Counts Catalog::counts() const {
    const std::lock_guard lock(mutex_);
    Counts counts;
    counts.block_cache_bytes = blocks_->usedBytes();
    counts.block_cache_hits = blocks_->hits();
    counts.block_cache_misses = blocks_->misses();
    counts.open_frames = frames_.size();
    for (const auto& [name, entry] : entries_)
        if (entry.dataset) {
            ++counts.datasets;
            counts.frames += std::uint64_t(entry.dataset->manifest().frames_size());
        }
    return counts;
}

}  // namespace brickyard
