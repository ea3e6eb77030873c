// One picture of `brickyard render`: drawn, composed and written.
#pragma once

#include <cstdint>
#include <filesystem>

#include "client/renderer.h"
#include "tools/render_options.h"

namespace brickyard {

// The files of one picture; in a sequence with its number. Empty: not asked for.
struct PictureFiles {
    std::filesystem::path output, over, explain;
    explicit PictureFiles(const RenderOptions& options);
    PictureFiles(const RenderOptions& options, std::uint32_t number);
};

// The picture of one frame, drawn and written. The outcome's picture is the one that was written. Errors:
// those of Renderer::render; of the image that it goes over; kIo.
Result<RenderOutcome> drawPicture(BrickSource& source, const RenderOptions& options, RenderRequest request,
                                  const PictureFiles& files);

}  // namespace brickyard
