// What the bindings of a scene share: entries checked one by one, each error a line that names its entry.
// Pure functions but for those that move a footer's channels.
#pragma once

#include <cmath>
#include <cstdint>
#include <glm/mat4x4.hpp>
#include <glm/vec3.hpp>
#include <string>

#include "core/result.h"
#include "proto/dataset.pb.h"

namespace brickyard {

// "scene: ENTRY: WHAT".
tl::unexpected<Error> refuseEntry(const std::string& entry, const std::string& what,
                                  ErrorCode code = ErrorCode::kInvalid);

// `otherwise` where nothing is given. Errors: kInvalid unless there are 3 finite numbers.
template <class Repeated>
Result<glm::dvec3> vectorEntry(const Repeated& numbers, const glm::dvec3& otherwise,
                               const std::string& entry) {
    if (numbers.empty()) return otherwise;
    if (numbers.size() != 3)
        return refuseEntry(entry, "wants 3 numbers, and has " + std::to_string(numbers.size()));
    const glm::dvec3 v(numbers[0], numbers[1], numbers[2]);
    if (!std::isfinite(v.x) || !std::isfinite(v.y) || !std::isfinite(v.z))
        return refuseEntry(entry, "is not finite");
    return v;
}
// The same, with no number below 0 and none above `most`.
template <class Repeated>
Result<glm::dvec3> colorEntry(const Repeated& numbers, const glm::dvec3& otherwise, const std::string& entry,
                              double most = HUGE_VAL) {
    const Result<glm::dvec3> color = vectorEntry(numbers, otherwise, entry);
    for (int c = 0; color && c < 3; ++c)
        if ((*color)[c] < 0 || (*color)[c] > most)
            return refuseEntry(entry,
                               most < HUGE_VAL ? "wants numbers from 0 to 1" : "wants no negative numbers");
    return color;
}
// `otherwise` where it is 0. Errors: kInvalid unless it is finite and at least 0.
Result<double> scaleEntry(double value, double otherwise, const std::string& entry);

// Index of the channel `name`, which must have `components` (0: any number). `place` follows the name in
// messages: "", or " in dataset 'smoke'". Errors: kNotFound (names the channels there are); kInvalid.
Result<std::uint32_t> channelEntry(const FrameFooter& frame, const std::string& name, unsigned components,
                                   const std::string& entry, const std::string& place = {});
// Of who names no density. Errors: kNotFound.
Result<std::uint32_t> densityEntry(const FrameFooter& frame, const std::string& entry,
                                   const std::string& place = {});

// Every channel: world = M * (index + offset). A transform that is none is refused when its channel is
// opened.
void moveSamples(const glm::dvec3& offset, FrameFooter& frame);
// Every channel: world = `to_world` * M * index.
void moveWorld(const glm::dmat4& to_world, FrameFooter& frame);

}  // namespace brickyard
