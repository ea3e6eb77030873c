// Several pictures of `brickyard render`, one after the other.
#pragma once

#include "client/renderer.h"
#include "core/result.h"
#include "tools/render_options.h"
#include "tools/render_sources.h"

namespace brickyard {

// Both tell of each picture (render_report.h) and give the exit status; a signal ends them between two
// pictures.

// Draws every frame there is, and each that comes, until none has come for so long (--follow).
Result<int> followFrames(RenderSources& sources, const RenderOptions& options, const RenderRequest& request);

// Draws the frames that were asked for (--frames); all of them are there, or nothing is drawn. While one is
// drawn the next is fetched, where no limit of bytes or time makes a picture depend on what came when.
Result<int> drawFrames(RenderSources& sources, const RenderOptions& options, const RenderRequest& request);

}  // namespace brickyard
