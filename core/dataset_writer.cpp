#include "core/dataset_writer.h"

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cassert>
#include <cerrno>
#include <chrono>
#include <cstdio>
#include <map>
#include <set>
#include <thread>
#include <vector>

#include "core/dataset.h"
#include "core/folder_lock.h"
#include "core/io_error.h"
#include "core/manifest_commit.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;

constexpr const char* kFramesFolder = "frames";
// Beside the dataset: NAME.tmp-PID-N@HOST is being built or is litter; NAME.previous-PID-N@HOST is an old
// dataset on a file system that cannot exchange two folders at once, and is put back if the new one never
// arrived.
constexpr const char* kBuildInfix = ".tmp-";
constexpr const char* kPreviousInfix = ".previous-";

// Removes what no living writer has: temporary frames, manifests and frame files that never got into the
// manifest.
void removeLitter(const fs::path& folder) {
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(folder / kFramesFolder, error))
        if (entry.path().filename().string().starts_with(kTemporaryPrefix) && isAbandoned(entry.path()))
            ::unlink(entry.path().c_str());
    // A frame that is about to be listed still has its temporary name, too. So one with a single name is
    // listed in the newest manifest (which is read after that name was counted), or never will be.
    std::vector<fs::path> single;
    for (const auto& entry : fs::directory_iterator(folder / kFramesFolder, error)) {
        struct stat status{};
        if (entry.path().extension() == ".brk" && ::lstat(entry.path().c_str(), &status) == 0 &&
            status.st_nlink == 1)
            single.push_back(entry.path());
    }
    if (const auto manifest = readNewestManifest(folder)) {
        std::set<std::string> listed;
        for (const FrameEntry& entry : manifest->frames()) listed.insert(entry.file());
        for (const fs::path& file : single)
            if (!listed.contains(fmt::format("{}/{}", kFramesFolder, file.filename().string())))
                ::unlink(file.c_str());
    }
    for (const auto& entry : fs::directory_iterator(folder, error))
        if (entry.path().filename().string().starts_with(fmt::format("{}manifest-", kTemporaryPrefix)) &&
            isAbandoned(entry.path()))
            ::unlink(entry.path().c_str());
}

int renameWith(const fs::path& from, const fs::path& to, unsigned flags) {
    return int(::syscall(SYS_renameat2, AT_FDCWD, from.c_str(), AT_FDCWD, to.c_str(), flags));
}
constexpr unsigned kRenameNoReplace = 1,
                   kRenameExchange = 2;  // of linux/fs.h, which not every libc passes on

fs::path parentOf(const fs::path& folder) {
    return folder.has_parent_path() ? folder.parent_path() : fs::path(".");
}

fs::path siblingOf(const fs::path& folder, const char* infix) {
    return parentOf(folder) / (folder.filename().string() + infix + ownerSuffix());
}

// Datasets that a killed writer left beside the real one.
void removeStaleSiblings(const fs::path& folder) {
    const std::string building = folder.filename().string() + kBuildInfix;
    const std::string previous = folder.filename().string() + kPreviousInfix;
    std::error_code error;
    for (const auto& entry : fs::directory_iterator(parentOf(folder), error)) {
        const std::string name = entry.path().filename();
        const bool old = name.starts_with(previous);
        if ((!old && !name.starts_with(building)) || !entry.is_directory(error)) continue;
        if (!isAbandoned(entry.path())) continue;
        if (old && !fs::exists(folder, error))
            fs::rename(entry.path(), folder, error);
        else
            fs::remove_all(entry.path(), error);
    }
}

std::string describeErrors(const Manifest& settings) {
    std::map<std::string, double> errors;
    for (const ErrorRequest& request : settings.error_requests())
        errors[request.channel()] = request.max_error();
    std::string text;
    for (const auto& [channel, error] : errors)
        text += fmt::format("{}{}{}{}", text.empty() ? "" : " ", channel, channel.empty() ? "" : "=", error);
    return text.empty() ? "0" : text;
}

std::string describeFilter(const Manifest& settings) {
    const std::set<std::string> names(settings.channel_filter().begin(), settings.channel_filter().end());
    return names.empty() ? "all" : fmt::format("{}", fmt::join(names, ","));
}

// The first setting in which the two differ, as "--error 0.1, not 0"; empty where they agree.
std::string settingsDifference(const Manifest& stored, const Manifest& wanted) {
    const auto differ = [](const char* option, const std::string& a, const std::string& b) {
        return a == b ? std::string() : fmt::format("{} {}, not {}", option, a, b);
    };
    for (const std::string& difference :
         {differ("--brick", std::to_string(stored.brick_edge()), std::to_string(wanted.brick_edge())),
          differ("--error", describeErrors(stored), describeErrors(wanted)),
          differ("drafts", stored.without_drafts() ? "off (--compact)" : "on",
                 wanted.without_drafts() ? "off (--compact)" : "on"),
          differ("--nonfinite", stored.nonfinite(), wanted.nonfinite()),
          differ("--channel", describeFilter(stored), describeFilter(wanted)),
          differ("--raw", stored.input_layout(), wanted.input_layout())})
        if (!difference.empty()) return difference;
    return {};
}

}  // namespace

struct DatasetWriter::State {
    fs::path folder;        // where the dataset is to stand
    fs::path build;         // where frames go: `folder`, or a folder beside it until finish()
    Descriptor build_lock;  // held on a folder beside, so that nobody takes it for litter
    Manifest manifest;
    bool created = false;   // the folder is ours: remove it again if nothing got into it
    bool exchange = false;  // `build` takes the place of `folder` at finish()
    std::map<fs::path, Descriptor> temporaries;

    // A folder beside the real one with a manifest of no frames, locked.
    Result<void> startBuild(const Manifest& settings) {
        // Between creation and lock the folder looks like litter, and another process may remove it.
        do {
            build = siblingOf(folder, kBuildInfix);
            if (::mkdir(build.c_str(), 0777) != 0) return ioError("create", build, errno);
            auto locked = lockFolder(build);
            if (!locked && locked.error().code != ErrorCode::kNotFound) return tl::unexpected(locked.error());
            if (locked) build_lock = std::move(*locked);
        } while (!build_lock);
        if (::mkdir((build / kFramesFolder).c_str(), 0777) != 0)
            return ioError("create", build / kFramesFolder, errno);
        manifest = settings;
        manifest.clear_frames();
        manifest.set_generation(1);
        auto committed = commitManifest(build, manifest);
        if (!committed) return tl::unexpected(committed.error());
        return {};
    }

    // Errors: kInvalid when somebody else made the folder meanwhile.
    Result<void> placeNew() {
        int renamed = renameWith(build, folder, kRenameNoReplace);
        // Not every file system knows the flag; a plain rename replaces nothing but an empty folder.
        if (renamed != 0) renamed = ::rename(build.c_str(), folder.c_str());
        if (renamed != 0 && (errno == EEXIST || errno == ENOTEMPTY || errno == ENOTDIR))
            return fail(ErrorCode::kInvalid,
                        fmt::format("{}: appeared while it was being created; run the same "
                                    "command again",
                                    folder.string()));
        if (renamed != 0) return ioError("create", folder, errno);
        build = folder;
        build_lock = Descriptor();
        return syncFolder(parentOf(folder));
    }

    // Reads the manifest as it is now, with the frames that other processes added.
    Result<void> reload() {
        auto newest = readNewestManifest(build);
        if (!newest) return tl::unexpected(newest.error());
        manifest = std::move(*newest);
        return {};
    }

    // Gives the file at `temporary` a free name as well. Both stay until the manifest has it, so that nobody
    // takes it for litter.
    Result<std::string> nameFrame(const fs::path& temporary, std::uint32_t frame) const {
        std::set<std::string> taken;
        for (const FrameEntry& other : manifest.frames()) taken.insert(other.file());
        for (int generation = 0;; ++generation) {
            const std::string file = generation == 0
                                         ? fmt::format("{}/{:06}.brk", kFramesFolder, frame)
                                         : fmt::format("{}/{:06}.{}.brk", kFramesFolder, frame, generation);
            if (taken.contains(file)) continue;
            if (::link(temporary.c_str(), (build / file).c_str()) == 0) return file;
            if (errno == EEXIST) continue;
            if (errno != EPERM && errno != ENOTSUP && errno != EOPNOTSUPP && errno != ENOSYS)
                return ioError("link", build / file, errno);
            // No links here: only the folder's lock keeps others from this name.
            if (::rename(temporary.c_str(), (build / file).c_str()) != 0)
                return ioError("rename", temporary, errno);
            return file;
        }
    }
};

// Puts the entry where its number belongs; gives the file of the one it replaces, or nothing.
static std::string insertFrame(Manifest& manifest, const FrameEntry& entry) {
    auto& frames = *manifest.mutable_frames();
    const auto place = std::find_if(frames.begin(), frames.end(),
                                    [&](const FrameEntry& other) { return other.frame() >= entry.frame(); });
    if (place != frames.end() && place->frame() == entry.frame()) {
        const std::string replaced = place->file();
        *place = entry;
        return replaced;
    }
    const int index = int(place - frames.begin());
    *frames.Add() = entry;
    for (int i = frames.size() - 1; i > index; --i) frames.SwapElements(i, i - 1);
    return {};
}

DatasetWriter::DatasetWriter(std::unique_ptr<State> state) : state_(std::move(state)) {}

Result<std::unique_ptr<DatasetWriter>> DatasetWriter::open(const fs::path& folder, const Manifest& settings,
                                                           ExistingDataset existing) {
    auto state = std::make_unique<State>();
    // "plume.bricks/" has no file name; siblings need one.
    state->folder = folder.has_filename() ? folder : folder.parent_path();
    std::unique_ptr<DatasetWriter> writer(new DatasetWriter(std::move(state)));
    State& s = *writer->state_;
    if (s.folder.filename().empty() || s.folder.filename() == "." || s.folder.filename() == "..")
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: not a name for a dataset; give a folder to create, such as "
                                "plume.bricks",
                                folder.string()));
    std::error_code error;
    if (!fs::is_directory(parentOf(s.folder), error))
        return fail(ErrorCode::kNotFound,
                    fmt::format("{}: no such folder; create it first", parentOf(s.folder).string()));
    removeStaleSiblings(s.folder);

    const bool exists = fs::exists(fs::symlink_status(s.folder, error));
    if (exists && !fs::is_directory(s.folder, error))
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: exists and is no folder; choose another name", s.folder.string()));
    const bool empty = exists && fs::is_empty(s.folder, error);
    const bool dataset = exists && fs::exists(s.folder / kManifestName, error);
    if (exists && !empty && !dataset)
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: exists and is no dataset (it has no {}); choose another name",
                                s.folder.string(), kManifestName));

    if (!dataset || existing == ExistingDataset::kOverwrite) {
        if (auto started = s.startBuild(settings); !started) return tl::unexpected(started.error());
        s.exchange = dataset;
        if (dataset) return writer;
        if (auto placed = s.placeNew(); !placed) {
            if (placed.error().code != ErrorCode::kInvalid) return tl::unexpected(placed.error());
            // Another process was faster, as when a farm starts on all frames at once: it is an existing
            // dataset now.
            writer.reset();
            return open(folder, settings, existing);
        }
        s.created = true;
        return writer;
    }

    s.build = s.folder;
    const auto locked = lockFolder(s.folder);
    if (!locked) return tl::unexpected(locked.error());
    if (auto loaded = s.reload(); !loaded) return tl::unexpected(loaded.error());
    if (const auto difference = settingsDifference(s.manifest, settings); !difference.empty())
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: was converted with {}; use the same settings to --append, or "
                                "--overwrite to start anew",
                                s.folder.string(), difference));
    ::mkdir((s.build / kFramesFolder).c_str(), 0777);
    removeLitter(s.build);
    return writer;
}

DatasetWriter::~DatasetWriter() {
    State& s = *state_;
    for (const auto& [path, descriptor] : s.temporaries) ::unlink(path.c_str());
    std::error_code error;
    if (s.build_lock) {
        fs::remove_all(s.build, error);
    } else if (s.created) {
        // Another process may have added frames to the folder that we made, or be about to: then it has files
        // there, and the folder of frames does not go.
        const auto locked = lockFolder(s.folder);
        if (locked && s.reload() && s.manifest.frames().empty() &&
            ::rmdir((s.folder / kFramesFolder).c_str()) == 0)
            fs::remove_all(s.folder, error);
    }
}

const Manifest& DatasetWriter::manifest() const { return state_->manifest; }

Result<fs::path> DatasetWriter::temporaryFrame(std::uint32_t frame) {
    for (;;) {
        fs::path path =
            state_->build / kFramesFolder / fmt::format("{}{:06}-{}", kTemporaryPrefix, frame, ownerSuffix());
        Descriptor descriptor(::open(path.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0644));
        if (!descriptor && errno == EEXIST) continue;
        if (!descriptor) return ioError("create", path, errno);
        // Between creation and lock it looked like litter, and may be gone.
        if (tryLock(descriptor) == LockState::kTaken || !stillNames(path, descriptor)) continue;
        state_->temporaries.emplace(path, std::move(descriptor));
        return path;
    }
}

Result<void> DatasetWriter::commitFrame(const fs::path& temporary, FrameEntry entry) {
    State& s = *state_;
    const auto held = s.temporaries.find(temporary);
    assert(held != s.temporaries.end());
    // A folder beside is locked already, and by us.
    Result<Descriptor> locked = s.build_lock ? Result<Descriptor>() : lockFolder(s.build);
    if (!locked) return tl::unexpected(locked.error());
    if (!s.build_lock)
        if (auto loaded = s.reload(); !loaded) return loaded;

    // A replaced frame keeps its file until the manifest means the new one, so the new one needs another
    // name.
    const auto file = s.nameFrame(temporary, entry.frame());
    if (!file) return tl::unexpected(file.error());
    entry.set_file(*file);
    std::string replaced;
    const auto commit = [&]() -> Result<void> {
        if (auto synced = syncFolder(s.build / kFramesFolder); !synced) return synced;
        for (;;) {
            Manifest next = s.manifest;
            next.set_generation(next.generation() + 1);
            replaced = insertFrame(next, entry);
            const auto committed = commitManifest(s.build, next);
            if (!committed) return tl::unexpected(committed.error());
            if (*committed) {
                s.manifest = std::move(next);
                return {};
            }
            // Somebody was faster; what they added must stay.
            std::this_thread::sleep_for(std::chrono::milliseconds(1 + ::getpid() % 7));
            if (auto loaded = s.reload(); !loaded) return loaded;
        }
    };
    if (auto committed = commit(); !committed) {
        // The failure may have come after the manifest was claimed; what it means must stay.
        const auto now = s.reload();
        const auto& entries = s.manifest.frames();
        if (now && std::none_of(entries.begin(), entries.end(),
                                [&](const FrameEntry& other) { return other.file() == *file; }))
            ::unlink((s.build / *file).c_str());
        return committed;
    }
    ::unlink(temporary.c_str());
    s.temporaries.erase(held);
    if (!replaced.empty()) ::unlink((s.build / replaced).c_str());
    return {};
}

Result<void> DatasetWriter::finish() {
    State& s = *state_;
    if (!s.exchange) return {};
    if (renameWith(s.build, s.folder, kRenameExchange) == 0) {
        // `build` now names the old dataset.
        std::error_code error;
        auto synced = syncFolder(parentOf(s.folder));
        fs::remove_all(s.build, error);
        s.build_lock = Descriptor();
        s.build = s.folder;
        s.exchange = false;
        return synced;
    }
    if (errno != EINVAL && errno != ENOSYS)
        return ioError("put the new dataset in place of", s.folder, errno);

    // Two renames; a kill between them is repaired by the next open, which puts the old one back.
    const fs::path previous = siblingOf(s.folder, kPreviousInfix);
    if (::rename(s.folder.c_str(), previous.c_str()) != 0) return ioError("rename", s.folder, errno);
    if (::rename(s.build.c_str(), s.folder.c_str()) != 0) {
        const int why = errno;
        ::rename(previous.c_str(), s.folder.c_str());
        return ioError("rename", s.build, why);
    }
    std::error_code error;
    auto synced = syncFolder(parentOf(s.folder));
    fs::remove_all(previous, error);
    s.build_lock = Descriptor();
    s.build = s.folder;
    s.exchange = false;
    return synced;
}

}  // namespace brickyard
