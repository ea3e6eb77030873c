#include "tools/scene_text.h"

#include <fmt/format.h>
#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <nlohmann/json.hpp>

namespace brickyard {

namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kOrder[] = {"datasets", "frame",    "camera", "background", "medium",
                                  "media",    "surfaces", "clip",   "lights",     "shutter"};

void print(const Json& json, std::size_t indent, std::string& out) {
    const bool row = json.is_array() && std::all_of(json.begin(), json.end(), [](const Json& part) {
                         return part.is_number() || part.is_string();
                     });
    if ((!json.is_object() && !json.is_array()) || json.empty()) {
        out += json.dump();
        return;
    }
    const std::string margin = row ? "" : "\n" + std::string(indent + 2, ' ');
    out += json.is_object() ? '{' : '[';
    bool first = true;
    for (const auto& [key, value] : json.items()) {
        if (!first) out += row ? ", " : ",";
        first = false;
        out += margin;
        if (json.is_object()) out += Json(key).dump() + ": ";
        print(value, indent + 2, out);
    }
    if (!row) out += "\n" + std::string(indent, ' ');
    out += json.is_object() ? '}' : ']';
}

}  // namespace

Result<std::string> printScene(const Scene& scene) {
    google::protobuf::util::JsonPrintOptions options;
    options.preserve_proto_field_names = true;
    std::string text;
    const auto status = google::protobuf::util::MessageToJsonString(scene, &text, options);
    if (!status.ok())
        return fail(ErrorCode::kInvalid,
                    fmt::format("the scene cannot be written: {}", std::string(status.message())));
    Json parsed = Json::parse(text, nullptr, /*allow_exceptions=*/false), ordered = Json::object();
    if (!parsed.is_object()) return fail(ErrorCode::kInvalid, "the scene cannot be written as JSON");
    for (const char* key : kOrder)
        if (parsed.contains(key)) ordered[key] = parsed[key];
    for (const auto& [key, value] : parsed.items())
        if (!ordered.contains(key)) ordered[key] = value;
    std::string out;
    print(ordered, 0, out);
    return out + "\n";
}

}  // namespace brickyard
