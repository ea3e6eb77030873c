// Who may open what: bearer tokens, each for all datasets or for some (docs/security.md). Immutable; any
// thread.
#pragma once

#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace brickyard {

// What one token opens.
struct Access {
    std::vector<std::string> datasets;  // empty: all of them
    bool allows(std::string_view dataset) const;
};

class AccessTokens {
public:
    static constexpr std::size_t kMaxTokenBytes = 4096;

    // Nobody is asked for a token.
    AccessTokens() = default;
    // A single token that opens everything.
    explicit AccessTokens(std::string token);
    // A line each: the token, and after white space the names of the datasets that it opens (percent-encoded,
    // so that a name may hold a space); all of them where no name follows. Empty lines and those that begin
    // with '#' do not count. Errors: kIo; kInvalid (names the line, never the token).
    static Result<AccessTokens> read(const std::filesystem::path& file);

    bool required() const { return !entries_.empty(); }
    // nullptr where the token is none of ours. Compares with every token, and all of each: how long that
    // takes tells nothing but the length of what was given.
    const Access* find(std::string_view token) const;

private:
    struct Entry {
        std::string token;
        Access access;
    };
    std::vector<Entry> entries_;
};

// Takes as long for a wrong first byte as for a wrong last one.
bool tokensMatch(std::string_view expected, std::string_view given);

}  // namespace brickyard
