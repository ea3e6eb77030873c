#include "server/catalog.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>

namespace brickyard {
namespace {

// The last part of the path as the user wrote it, without the extension that datasets carry.
std::string nameOf(const std::filesystem::path& folder) {
    auto path = std::filesystem::absolute(folder).lexically_normal();
    if (!path.has_filename()) path = path.parent_path();
    std::string name = path.filename().string();
    constexpr std::string_view kExtension = ".bricks";
    if (name.size() > kExtension.size() && name.ends_with(kExtension))
        name.resize(name.size() - kExtension.size());
    return name;
}

// Cheap signs that the frame files are those that the manifest means.
Result<void> checkFrames(const Dataset& dataset) {
    for (const FrameEntry& entry : dataset.manifest().frames()) {
        const auto file = dataset.folder() / entry.file();
        std::error_code error;
        const auto bytes = std::filesystem::file_size(file, error);
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

}  // namespace

Catalog::Catalog(std::size_t max_open_frames, std::uint64_t block_cache_bytes)
    : max_open_frames_(max_open_frames), blocks_(std::make_shared<BlockCache>(block_cache_bytes)) {}

Catalog::Stamp Catalog::stampOf(const std::filesystem::path& folder) {
    // Where the manifest cannot be read, the stamp stays as it is and so does the dataset.
    std::error_code error;
    Stamp stamp;
    stamp.modified = std::filesystem::last_write_time(folder / kManifestName, error);
    stamp.bytes = std::filesystem::file_size(folder / kManifestName, error);
    return stamp;
}

Result<std::unique_ptr<Catalog>> Catalog::open(const std::vector<std::filesystem::path>& folders,
                                               std::size_t max_open_frames, std::uint64_t block_cache_bytes) {
    std::unique_ptr<Catalog> catalog(new Catalog(max_open_frames, block_cache_bytes));
    for (const auto& folder : folders) {
        Entry entry;
        entry.folder = folder;
        entry.stamp = stampOf(folder);
        auto dataset = Dataset::open(folder);
        if (!dataset) return tl::unexpected(dataset.error());
        if (auto checked = checkFrames(*dataset); !checked) return tl::unexpected(checked.error());
        entry.dataset = std::make_shared<const Dataset>(std::move(*dataset));

        const std::string name = nameOf(folder);
        const auto [other, is_new] = catalog->entries_.emplace(name, std::move(entry));
        if (!is_new)
            return fail(ErrorCode::kInvalid,
                        fmt::format("{} and {}: both datasets would be called {}; rename one of the folders",
                                    other->second.folder.string(), folder.string(), name));
        catalog->names_.push_back(name);
    }
    std::sort(catalog->names_.begin(), catalog->names_.end());
    return catalog;
}

Result<std::shared_ptr<const Dataset>> Catalog::dataset(const std::string& name) const {
    const std::lock_guard lock(mutex_);
    const auto found = entries_.find(name);
    if (found == entries_.end())
        return fail(ErrorCode::kNotFound,
                    fmt::format("no dataset {:?} here; there are: {}", name, fmt::join(names_, ", ")));
    Entry& entry = found->second;
    // The manifest is replaced atomically, so a new stamp means a whole new manifest. One that cannot be read
    // now (the folder is being exchanged) leaves the old one in place until the next question.
    if (const Stamp now = stampOf(entry.folder); now != entry.stamp) {
        if (auto reopened = Dataset::open(entry.folder)) {
            entry.dataset = std::make_shared<const Dataset>(std::move(*reopened));
            entry.stamp = now;
        }
    }
    return entry.dataset;
}

Result<std::shared_ptr<const FrameReader>> Catalog::frame(const std::string& name,
                                                          std::uint32_t frame) const {
    const auto from = dataset(name);
    if (!from) return tl::unexpected(from.error());
    const FrameEntry* entry = (*from)->findFrame(frame);
    if (entry == nullptr)
        return fail(ErrorCode::kNotFound, fmt::format("{}: no frame {}; there are: {}", name, frame,
                                                      describeFrames((*from)->manifest())));
    const auto same = [&](const OpenFrame& open) {
        return open.frame == frame && open.footer_checksum == entry->footer_xxh64() && open.name == name;
    };
    {
        const std::lock_guard lock(mutex_);
        if (const auto open = std::find_if(frames_.begin(), frames_.end(), same); open != frames_.end()) {
            frames_.splice(frames_.begin(), frames_, open);
            return open->reader;
        }
    }
    // Opened without the lock: a slow disk must not stop those whose frames are open.
    auto store = (*from)->openFrame(frame);
    if (!store) return tl::unexpected(store.error());
    auto reader = std::make_shared<const FrameReader>(std::move(*store), blocks_);
    const std::lock_guard lock(mutex_);
    frames_.push_front({name, frame, entry->footer_xxh64(), reader});
    // Whoever still reads from a frame that leaves the list keeps it open.
    if (frames_.size() > max_open_frames_) frames_.pop_back();
    return reader;
}

}  // namespace brickyard
