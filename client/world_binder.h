// bindWorld() at work: one scene, read once. The first error stays, and what is read after it does not
// matter. Not thread-safe; used inside client/world_*.cpp only.
#pragma once

#include <glm/vec3.hpp>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "client/scene_entry.h"
#include "client/world_settings.h"

namespace brickyard {

class WorldBinder {
public:
    // REQUIRES: at least one frame; all outlive the binder.
    WorldBinder(const Scene& scene, std::span<const BoundFrame> frames, const std::filesystem::path& folder)
        : scene_(scene), frames_(frames), folder_(folder), offsets_(frames.size()) {}
    Result<WorldSettings> bind();

private:
    void refuse(const std::string& entry, const std::string& what, ErrorCode code = ErrorCode::kInvalid) {
        if (!error_) error_ = refuseEntry(entry, what, code).value();
    }
    // The value, or a default one and the error is kept.
    template <class T>
    T take(Result<T> result) {
        if (result) return std::move(*result);
        if (!error_) error_ = std::move(result.error());
        return T{};
    }
    template <class T>
    std::shared_ptr<const T> share(Result<T> result) {
        if (result) return std::make_shared<const T>(std::move(*result));
        if (!error_) error_ = std::move(result.error());
        return nullptr;
    }

    // world_binder.cpp
    std::string nameOf(std::uint32_t frame) const;
    std::string placeOf(std::uint32_t frame) const;  // " in dataset 'smoke'"; "" where it has no name
    std::uint32_t frameOf(const std::string& dataset, const std::string& entry);
    const FrameFooter& footer(std::uint32_t frame) const { return *frames_[frame].footer; }
    FieldBinding channel(std::uint32_t frame, const std::string& name, unsigned components,
                         const std::string& entry);
    FieldBinding densityOf(std::uint32_t frame, const std::string& name, const std::string& entry);
    // Nullptr where the index is of no channel: an error was found before.
    const ChannelFooter* footerOf(const FieldBinding& binding) const;
    FieldFilter filter(const std::string& name, const std::string& entry);
    template <class Entry>
    void noteOffset(const Entry& user, const std::string& where);
    void placeDatasets();
    SurfaceSettings surface(const Surface& from, const std::string& where);
    void clip(WorldClip& out);
    void shutter(WorldSettings& world);

    // world_medium.cpp
    MediumSettings medium(const Medium& from, const std::string& where);
    void scatter(const Medium& from, const std::string& where, MediumSettings& out);
    void transfer(const Medium& from, const std::string& where, MediumSettings& out);
    MediumEmission emission(const Emission& from, std::uint32_t frame, const std::string& where);

    // world_light.cpp
    WorldLight light(const Light& from, const std::string& where);
    WorldLight::Kind lightKind(const Light& from, const std::string& where);
    void environment(const Light& from, const std::string& where, WorldLight& out);
    void shadows(const Light& from, const std::string& where, WorldLight& out);
    glm::dvec3 unit(const google::protobuf::RepeatedField<double>& numbers, const glm::dvec3& otherwise,
                    const std::string& entry);

    const Scene& scene_;
    std::span<const BoundFrame> frames_;
    const std::filesystem::path& folder_;
    // Of each frame: what was said of its samples, and who said it.
    struct Offset {
        std::string entry;
        glm::dvec3 value{0};
    };
    std::vector<std::optional<Offset>> offsets_;
    std::vector<std::pair<const Medium*, std::string>> media_;  // with their entries' names
    std::optional<Error> error_;
};

}  // namespace brickyard
