#include "server/server_log.h"

#include <fmt/format.h>
#include <spdlog/pattern_formatter.h>
#include <spdlog/sinks/stdout_sinks.h>

#include <algorithm>
#include <nlohmann/json.hpp>
#include <string>

namespace brickyard {
namespace {

// As JSON writes it, with quotes; bytes that are not UTF-8 are replaced.
std::string quoted(std::string_view text) {
    return nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

std::string plainOrQuoted(std::string_view text) {
    const bool is_plain = !text.empty() && std::all_of(text.begin(), text.end(), [](char c) {
        return c > ' ' && c <= '~' && c != '"' && c != '=' && c != '\\';
    });
    return is_plain ? std::string(text) : quoted(text);
}

std::string numberOr(const ServerLog::Value& value, std::string (*text)(std::string_view)) {
    if (const auto* number = std::get_if<std::uint64_t>(&value)) return std::to_string(*number);
    return text(std::get<std::string_view>(value));
}

}  // namespace

// Not registered with spdlog: several servers may run in one process.
ServerLog::ServerLog(const ServerOptions& options)
    : format_(options.log_format),
      logger_(std::make_shared<spdlog::logger>("brickyard serve",
                                               std::make_shared<spdlog::sinks::stderr_sink_mt>())) {
    logger_->set_level(spdlog::level::from_str(options.log_level));
    const bool json = format_ == LogFormat::kJson;
    logger_->set_formatter(std::make_unique<spdlog::pattern_formatter>(
        json ? R"({"time":"%Y-%m-%dT%H:%M:%S.%eZ","level":"%l",%v})" : "[%Y-%m-%d %H:%M:%S.%e] [%l] %v",
        json ? spdlog::pattern_time_type::utc : spdlog::pattern_time_type::local));
}

void ServerLog::write(LogLevel level, std::string_view event, std::initializer_list<Field> fields) const {
    if (!wants(level)) return;
    std::string line;
    if (format_ == LogFormat::kJson) {
        line = fmt::format("\"event\":{}", quoted(event));
        for (const auto& [name, value] : fields)
            line += fmt::format(",\"{}\":{}", name, numberOr(value, quoted));
    } else {
        line = event;
        for (const auto& [name, value] : fields)
            line += fmt::format(" {}={}", name, numberOr(value, plainOrQuoted));
    }
    logger_->log(level, line);
}

}  // namespace brickyard
