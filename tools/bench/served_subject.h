// What the benchmarks of the server serve: a sequence of caches as a dataset, and its topology in memory, for
// clients that know what they look for. Immutable once made: any thread.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "client/paged_channel.h"
#include "core/frame_reader.h"
#include "core/page_wish.h"
#include "core/result.h"
#include "core/view_descent.h"
#include "proto/scene.pb.h"
#include "tools/bench/benchmark.h"

namespace brickyard {

struct SubjectFrame {
    std::uint32_t frame = 0;
    std::shared_ptr<const FrameReader> reader;
    std::uint32_t channel = 0;                 // of density
    std::shared_ptr<const PagedChannel> tree;  // with every block

    const ChannelFooter& footer() const { return reader->footer().channels(int(channel)); }
    Result<std::shared_ptr<const TreeBlock>> block(std::uint32_t index) const {
        return reader->block(channel, index);
    }
};

struct ServedSubject {
    std::string cache;  // "plume_fire 24"
    std::filesystem::path folder;
    std::vector<SubjectFrame> frames;
    std::uint64_t payload_bytes = 0;  // of all frames
};

// The density of the first cache's whole sequence, converted into the scratch folder.
Result<ServedSubject> convertServed(const BenchOptions& options);

// Every page of a frame, coarse first, and their bytes.
struct EveryPage {
    std::vector<WishedPage> pages;
    std::uint64_t bytes = 0;
};
EveryPage everyPage(const SubjectFrame& frame);

}  // namespace brickyard
