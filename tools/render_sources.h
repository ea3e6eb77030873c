// The datasets that a picture is drawn from, opened: the command line's, or those that the scene names, and
// for a picture between two frames each once more, for the frame after. One thread.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "client/brick_source.h"
#include "client/renderer.h"
#include "core/result.h"

namespace brickyard {

class RenderSources {
public:
    // `source`: the command line's; empty: the first of the scene's. `frame`: the scene's frame, where it is
    // known. REQUIRES: the request's scene, camera and folder are there. A dataset that nothing in the scene
    // reads is not opened. Errors: kInvalid (no dataset, or names that say nothing); those of openSource().
    static Result<RenderSources> open(const std::string& source, const SourceAccess& access,
                                      const RenderRequest& request, std::optional<double> frame);

    // What is drawn where the scene names no other.
    BrickSource& first() const { return *datasets_.front().source; }
    // Another connection to the same. Errors: those of openSource().
    Result<std::unique_ptr<BrickSource>> openFirstAgain() const {
        return openSource(datasets_.front().address, access_, {}, timeouts_);
    }
    // The scene's frame that draws `frame` of the first dataset. Errors: kInvalid (it would be below 0).
    Result<double> sceneFrame(std::uint32_t frame) const;
    // The one that draws the first frame there is. Errors: kNotFound.
    Result<double> firstFrame() const;
    // Errors: kNotFound (names the dataset, the frame, and those there are).
    Result<void> requireFrame(double scene_frame) const;
    // Gives the request the scene's frame: frame, between, dataset, others, next. They refer to this object.
    // Errors: those of requireFrame(), but for a whole frame of the first dataset, which may be about to
    // come; those of openSource().
    Result<void> choose(double scene_frame, RenderRequest& request);

private:
    struct OpenDataset {
        std::string name, address;
        std::int64_t frame_offset = 0;
        std::unique_ptr<BrickSource> source;
        std::unique_ptr<BrickSource> after;  // opened when first needed
    };
    Result<std::uint32_t> frameOf(const OpenDataset& dataset, std::int64_t scene_frame) const;
    Result<void> requireFrame(const OpenDataset& dataset, std::int64_t scene_frame) const;

    SourceAccess access_;
    StreamTimeouts timeouts_;
    std::vector<OpenDataset> datasets_;  // at least one
};

}  // namespace brickyard
