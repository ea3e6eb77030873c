// Which input files make which frame. Looks at names and at what exists; opens nothing.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "core/result.h"

namespace brickyard {

struct FrameInputs {
    std::uint32_t frame = 0;
    std::vector<std::filesystem::path> files;  // in the order they were named
};

// Frame numbers as a user lists them: "10-19", "1,5,10-20:2" or "10-20x2". A range may be huge; it is kept as
// such.
class FrameSet {
public:
    // Errors: kInvalid.
    static Result<FrameSet> parse(const std::string& text);
    bool contains(std::uint32_t frame) const;
    // The lowest number that is not `there`. Its cost is what is there, not what is asked for.
    std::optional<std::uint32_t> firstMissing(const std::set<std::uint32_t>& there) const;

private:
    struct Range {
        std::uint32_t first, last, step;
    };
    std::vector<Range> ranges_;
};

// The last run of digits in a file name without its extension: plume.0018.vdb is 18. Nothing where there is
// none, or where it has more than 9 digits (a date or an identifier, not a frame).
std::optional<std::uint32_t> frameNumber(const std::filesystem::path& file);

// The frames that `inputs` make, rising. An input that does not exist as it is written may be a pattern:
// - with a place for the frame number, %04d, %d, ####, $F4 or $F, in its file name: all existing files of any
//   number, with at least as many digits as are asked for; or
// - with *, ? or [, as a shell has them: all files, in the order of their names.
// A file without such a place has the number of frameNumber; those without any count 0, 1, 2 ... in order.
// Files of one number make one frame. Errors: kNotFound.
Result<std::vector<FrameInputs>> planInputs(const std::vector<std::string>& inputs);

}  // namespace brickyard
