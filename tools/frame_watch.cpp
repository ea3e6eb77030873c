#include "tools/frame_watch.h"

#include <fmt/format.h>
#include <fnmatch.h>
#include <poll.h>
#include <sys/inotify.h>
#include <unistd.h>

#include <algorithm>
#include <map>
#include <set>

#include "core/io_error.h"
#include "tools/frame_plan.h"
#include "tools/progress_line.h"
#include "tools/source_identity.h"

namespace brickyard {
namespace {

using Clock = std::chrono::steady_clock;
using Seconds = std::chrono::duration<double>;

// Wakes when something in a folder changes. Where the kernel cannot tell (no inotify, or a change made by
// another machine) it is a pause, and the folder is looked through after it.
class FolderAlarm {
public:
    explicit FolderAlarm(const std::filesystem::path& folder) : descriptor_(::inotify_init1(IN_CLOEXEC)) {
        if (descriptor_ >= 0)
            ::inotify_add_watch(descriptor_, folder.c_str(), IN_CLOSE_WRITE | IN_MOVED_TO | IN_CREATE);
    }
    ~FolderAlarm() {
        if (descriptor_ >= 0) ::close(descriptor_);
    }
    FolderAlarm(const FolderAlarm&) = delete;
    FolderAlarm& operator=(const FolderAlarm&) = delete;

    void wait(Seconds limit) {
        const int milliseconds = std::max(1, int(limit.count() * 1000));
        pollfd waiting{descriptor_, POLLIN, 0};
        if (::poll(&waiting, descriptor_ >= 0 ? 1 : 0, milliseconds) <= 0) return;
        // What changed is seen by looking.
        char events[4096];
        [[maybe_unused]] const ssize_t drained = ::read(descriptor_, events, sizeof events);
    }

private:
    int descriptor_;
};

class FrameWatch {
public:
    FrameWatch(const WatchOptions& watch, ConversionOptions options)
        : watch_(watch), options_(std::move(options)) {
        options_.existing = ExistingDataset::kAppend;
        options_.settle = Seconds(0);  // seen to here
    }

    Result<WatchReport> run() {
        std::error_code error;
        if (!std::filesystem::is_directory(watch_.folder, error))
            return fail(ErrorCode::kNotFound,
                        fmt::format("{}: no such folder to watch; create it first", watch_.folder.string()));
        FolderAlarm alarm(watch_.folder);
        for (;;) {
            const std::size_t waiting = takeComplete();
            if (stopped()) {
                report_.stopped = true;
                break;
            }
            if (watch_.until_frame && waiting == 0 && done_.contains(*watch_.until_frame)) break;
            const Seconds quiet = Clock::now() - last_change_;
            if (watch_.idle && waiting == 0 && quiet > *watch_.idle) break;
            alarm.wait(std::clamp(watch_.settle / 4, Seconds(0.02), Seconds(1)));
        }
        for (const auto& [frame, seen] : seen_) report_.failed += seen.failed;
        return report_;
    }

private:
    // What was last seen of a frame's files, and since when they have been so.
    struct Seen {
        std::vector<std::string> keys;
        Clock::time_point since;
        bool failed = false;
    };

    bool stopped() const { return options_.stop && options_.stop(); }

    bool matches(const std::string& name) const {
        if (name.starts_with('.')) return false;
        if (!watch_.pattern.empty()) return ::fnmatch(watch_.pattern.c_str(), name.c_str(), 0) == 0;
        const std::string extension = std::filesystem::path(name).extension();
        return extension == ".vdb" || extension == ".nvdb" || extension == ".nrrd" || extension == ".nhdr";
    }

    std::vector<FrameInputs> listFrames() {
        std::vector<std::string> files;
        std::error_code error;
        for (const auto& entry : std::filesystem::directory_iterator(watch_.folder, error)) {
            if (!matches(entry.path().filename())) continue;
            if (frameNumber(entry.path()))
                files.push_back(entry.path().string());
            else if (unnumbered_.insert(entry.path()).second && options_.note)
                options_.note(
                    fmt::format("{}: its name has no frame number; it is left out", entry.path().string()));
        }
        std::sort(files.begin(), files.end());
        // A file that went away in between comes again or does not.
        auto frames = planInputs(files);
        return frames ? std::move(*frames) : std::vector<FrameInputs>();
    }

    // Converts what is complete; gives how many frames are still being written.
    std::size_t takeComplete() {
        std::size_t waiting = 0;
        for (const FrameInputs& frame : listFrames()) {
            if (stopped()) break;
            if (done_.contains(frame.frame)) continue;
            const auto keys = sourceKeys(frame.files);
            const auto now = Clock::now();
            Seen& seen = seen_[frame.frame];
            if (seen.keys != keys) {
                seen = {keys, now, false};
                last_change_ = now;
            }
            if (seen.failed) continue;
            if (now - seen.since < watch_.settle)
                ++waiting;
            else
                take(frame, seen);
        }
        return waiting;
    }

    void take(const FrameInputs& frame, Seen& seen) {
        options_.inputs.clear();
        for (const auto& file : frame.files) options_.inputs.push_back(file.string());
        const auto report = convert(options_);
        last_change_ = Clock::now();
        if (!report) {
            if (stopped()) return;
            seen.failed = true;
            watch_.tell(fmt::format("frame {}: {}; waiting for its file to change", frame.frame,
                                    report.error().message));
            return;
        }
        if (report->stopped) return;
        done_.insert(frame.frame);
        seen_.erase(frame.frame);
        report_.converted += report->converted;
        if (report->converted == 0) return;
        std::uint64_t bytes = 0;
        for (const FrameEntry& entry : report->frames) bytes += entry.file_bytes();
        watch_.tell(fmt::format("frame {}: {} from {}, in {}", frame.frame, describeBytes(bytes),
                                describeBytes(report->input_bytes), describeSeconds(report->seconds)));
    }

    const WatchOptions& watch_;
    ConversionOptions options_;
    std::set<std::uint32_t> done_;
    std::map<std::uint32_t, Seen> seen_;
    std::set<std::filesystem::path> unnumbered_;
    Clock::time_point last_change_ = Clock::now();
    WatchReport report_;
};

}  // namespace

Result<WatchReport> watchFrames(const WatchOptions& watch, ConversionOptions options) {
    return FrameWatch(watch, std::move(options)).run();
}

}  // namespace brickyard
