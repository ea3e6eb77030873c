#include "tools/bench/contender.h"

namespace brickyard {

Result<void> race(std::vector<Contender>& contenders, unsigned rounds) {
    for (unsigned round = 0; round < rounds; ++round)
        for (Contender& contender : contenders) {
            if (round >= contender.max_rounds) continue;
            const Result<double> seconds = contender.draw(round == 0 ? &contender.error : nullptr);
            if (!seconds) return tl::unexpected(seconds.error());
            contender.timing.add(*seconds);
        }
    return {};
}

const Contender* cheapestOfOurs(const std::vector<Contender>& contenders, double rms) {
    const Contender* best = nullptr;
    for (const Contender& contender : contenders)
        if (contender.ours && contender.error.rms() <= rms &&
            (!best || contender.timing.median() < best->timing.median()))
            best = &contender;
    return best;
}

nlohmann::json toJson(const Contender& contender) {
    nlohmann::json json{
        {"name", contender.name},
        {"seconds", contender.timing.median()},
        {"seconds_best", contender.timing.best()},
        {"mrays_per_second", double(contender.error.pixels()) / contender.timing.median() / 1e6},
        {"rms", contender.error.rms()},
        {"worst", contender.error.worst()}};
    if (contender.ours) json["error"] = toJson(contender.error);
    return json;
}

}  // namespace brickyard
