#include "server/access_tokens.h"

#include <fmt/format.h>

#include <algorithm>
#include <fstream>
#include <sstream>

#include "core/percent_code.h"

namespace brickyard {

bool Access::allows(std::string_view dataset) const {
    return datasets.empty() || std::find(datasets.begin(), datasets.end(), dataset) != datasets.end();
}

bool tokensMatch(std::string_view expected, std::string_view given) {
    unsigned difference = expected.size() == given.size() ? 0 : 1;
    for (std::size_t i = 0; i < given.size(); ++i)
        difference |= static_cast<unsigned char>(given[i]) ^
                      (expected.empty() ? 0u : static_cast<unsigned char>(expected[i % expected.size()]));
    return difference == 0;
}

AccessTokens::AccessTokens(std::string token) { entries_.push_back({std::move(token), {}}); }

Result<AccessTokens> AccessTokens::read(const std::filesystem::path& file) {
    std::ifstream in(file);
    if (!in)
        return fail(ErrorCode::kIo, fmt::format("{}: cannot read the tokens; give a file with a token a line",
                                                file.string()));
    AccessTokens tokens;
    std::string line;
    for (std::size_t number = 1; std::getline(in, line); ++number) {
        std::istringstream words(line);
        Entry entry;
        if (!(words >> entry.token) || entry.token.front() == '#') continue;
        if (entry.token.size() > kMaxTokenBytes)
            return fail(ErrorCode::kInvalid, fmt::format("{}: line {}: a token has at most {} bytes",
                                                         file.string(), number, kMaxTokenBytes));
        for (std::string name; words >> name;) {
            auto decoded = percentDecode(name);
            if (!decoded)
                return fail(ErrorCode::kInvalid,
                            fmt::format("{}: line {}: {}", file.string(), number, decoded.error().message));
            entry.access.datasets.push_back(std::move(*decoded));
        }
        tokens.entries_.push_back(std::move(entry));
    }
    // A file that was cut to nothing must not open the server to everybody.
    if (tokens.entries_.empty())
        return fail(
            ErrorCode::kInvalid,
            fmt::format("{}: holds no token; write one a line, or leave --token-file out", file.string()));
    return tokens;
}

const Access* AccessTokens::find(std::string_view token) const {
    const Access* found = nullptr;
    for (const Entry& entry : entries_)
        if (tokensMatch(entry.token, token) && found == nullptr) found = &entry.access;
    return found;
}

}  // namespace brickyard
