// Frames and folders for tests of the dataset files: a ball of known values, built by the real builder.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <bit>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "core/brick_store.h"
#include "core/dataset.h"
#include "core/frame_writer.h"
#include "core/octree_builder.h"

namespace brickyard {

// A fresh folder that goes away with the test.
class ScratchFolder {
public:
    ScratchFolder() {
        std::string name = (std::filesystem::path(testing::TempDir()) / "brickyard-XXXXXX").string();
        folder_ = ::mkdtemp(name.data());
    }
    ~ScratchFolder() {
        std::error_code error;
        std::filesystem::remove_all(folder_, error);
    }
    std::filesystem::path operator/(const std::string& name) const { return folder_ / name; }
    const std::filesystem::path& path() const { return folder_; }

private:
    std::filesystem::path folder_;
};

// f = 1 - |p - centre| / radius inside a ball, else 0 and inactive.
class BallField final : public FieldSource {
public:
    explicit BallField(double radius, std::string name = "density") : radius_(radius) {
        info_.name = std::move(name);
        const auto r = std::int64_t(radius) + 1;
        info_.active_box = {{-r, -r, -r}, {r + 1, r + 1, r + 1}};
        // The tight box and count follow from the formula.
        IndexBox tight{{r, r, r}, {-r, -r, -r}};
        for (std::int64_t z = -r; z <= r; ++z)
            for (std::int64_t y = -r; y <= r; ++y)
                for (std::int64_t x = -r; x <= r; ++x) {
                    if (at(x, y, z) <= 0) continue;
                    ++info_.active_voxels;
                    const Index3 p{x, y, z};
                    for (std::size_t a = 0; a < 3; ++a) {
                        tight.begin[a] = std::min(tight.begin[a], p[a]);
                        tight.end[a] = std::max(tight.end[a], p[a] + 1);
                    }
                }
        info_.active_box = tight;
    }
    float at(std::int64_t x, std::int64_t y, std::int64_t z) const {
        const double d = std::sqrt(double(x * x + y * y + z * z)) / radius_;
        return d < 1 ? float(1 - d) : 0.0f;
    }
    const ChannelInfo& info() const override { return info_; }
    std::optional<UniformRegion> uniformOver(const IndexBox& box) const override {
        if (intersect(box, info_.active_box).empty()) return UniformRegion{{0}, false};
        return std::nullopt;
    }
    Result<void> read(const IndexBox& box, SampleBlock& out) const override {
        out.values.clear();
        out.active.clear();
        for (std::int64_t z = box.begin[2]; z < box.end[2]; ++z)
            for (std::int64_t y = box.begin[1]; y < box.end[1]; ++y)
                for (std::int64_t x = box.begin[0]; x < box.end[0]; ++x) {
                    const auto bytes = std::bit_cast<std::array<std::byte, 4>>(at(x, y, z));
                    out.values.insert(out.values.end(), bytes.begin(), bytes.end());
                    out.active.push_back(at(x, y, z) > 0);
                }
        return {};
    }

private:
    double radius_;
    ChannelInfo info_;
};

// A frame file at `file`; gives its entry for a manifest, but for the file's name.
inline FrameEntry writeBallFrame(const std::filesystem::path& file, std::uint32_t frame, double radius) {
    const BallField field(radius);
    const FieldSource* const fields[] = {&field};
    BuildOptions options;
    options.shape.edge_cells = 8;
    auto writer = FrameWriter::create(file);
    EXPECT_TRUE(writer) << writer.error().message;
    const auto footer = buildFrame(fields, std::span(&options, 1), **writer);
    EXPECT_TRUE(footer) << footer.error().message;
    const auto finished = (*writer)->finish(*footer);
    EXPECT_TRUE(finished) << finished.error().message;
    FrameEntry entry;
    entry.set_frame(frame);
    entry.set_file_bytes(finished->file_bytes);
    entry.set_footer_xxh64(finished->footer_checksum);
    return entry;
}

inline std::string readFile(const std::filesystem::path& file) {
    std::ifstream stream(file, std::ios::binary);
    return {std::istreambuf_iterator<char>(stream), {}};
}
inline void writeFile(const std::filesystem::path& file, const std::string& bytes) {
    std::ofstream(file, std::ios::binary) << bytes;
}

}  // namespace brickyard
