// Datasets made of formulas, and pictures of them, for tests of the renderer.
#pragma once

#include <gtest/gtest.h>

#include "client/renderer.h"
#include "core/dataset_writer.h"
#include "frame_fixture.h"

namespace brickyard {

// Frame 0 of a new dataset at `folder`, an octree for each field; a frame of another number is added to the
// dataset that is there.
inline Result<void> storeFields(const std::filesystem::path& folder,
                                const std::vector<const FieldSource*>& fields, int edge = 8,
                                double max_error = 0, std::uint32_t number = 0) {
    Manifest settings;
    settings.set_format_major(kFormatMajor);
    settings.set_brick_edge(std::uint32_t(edge));
    settings.set_nonfinite("reject");
    auto writer = DatasetWriter::open(folder, settings,
                                      number == 0 ? ExistingDataset::kOverwrite : ExistingDataset::kAppend);
    if (!writer) return tl::unexpected(writer.error());
    const auto temporary = (*writer)->temporaryFrame(number);
    if (!temporary) return tl::unexpected(temporary.error());
    auto frame = FrameWriter::create(*temporary);
    if (!frame) return tl::unexpected(frame.error());
    BuildOptions options;
    options.shape.edge_cells = edge;
    options.max_error = max_error;
    const std::vector<BuildOptions> all(fields.size(), options);
    const auto footer = buildFrame(fields, all, **frame);
    if (!footer) return tl::unexpected(footer.error());
    const auto finished = (*frame)->finish(*footer);
    if (!finished) return tl::unexpected(finished.error());
    FrameEntry entry;
    entry.set_frame(number);
    entry.set_file_bytes(finished->file_bytes);
    entry.set_footer_xxh64(finished->footer_checksum);
    if (auto committed = (*writer)->commitFrame(*temporary, entry); !committed) return committed;
    return (*writer)->finish();
}

inline Result<RenderOutcome> drawStored(const std::filesystem::path& folder, const RenderRequest& request) {
    auto source = openSource(folder.string(), "");
    if (!source) return tl::unexpected(source.error());
    return makeCpuRenderer()->render(**source, request);
}

inline Camera cameraAt(const glm::dvec3& eye, const glm::dvec3& target, double fov_degrees = 40,
                       const glm::dvec3& up = {0, 1, 0}) {
    Camera camera;
    for (int a = 0; a < 3; ++a) {
        camera.add_eye(eye[a]);
        camera.add_target(target[a]);
        camera.add_up(up[a]);
    }
    camera.set_vertical_fov_degrees(fov_degrees);
    return camera;
}

}  // namespace brickyard
