// The file of tokens, and how a token is looked up.
#include "server/access_tokens.h"

#include <gmock/gmock.h>

#include "stored_file.h"

namespace brickyard {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

class AccessTokensTest : public testing::Test {
protected:
    Result<AccessTokens> read(const std::string& text) {
        file_.write(text);
        return AccessTokens::read(file_.path());
    }
    StoredFile file_{"tokens"};
};

TEST_F(AccessTokensTest, ReadsALineForEachToken) {
    const auto tokens =
        read("# who may come in\n\n  everything  \nsome tiny my%20plume\n\t#not-a-token\ncrlf tiny\r\n");
    ASSERT_TRUE(tokens) << tokens.error().message;
    EXPECT_TRUE(tokens->required());
    ASSERT_NE(tokens->find("everything"), nullptr);
    EXPECT_TRUE(tokens->find("everything")->datasets.empty());
    ASSERT_NE(tokens->find("some"), nullptr);
    EXPECT_THAT(tokens->find("some")->datasets, ElementsAre("tiny", "my plume"));
    EXPECT_TRUE(tokens->find("some")->allows("my plume"));
    EXPECT_FALSE(tokens->find("some")->allows("plume"));
    ASSERT_NE(tokens->find("crlf"), nullptr);
    EXPECT_THAT(tokens->find("crlf")->datasets, ElementsAre("tiny"));
    for (const char* none : {"", "#", "#not-a-token", "tiny", "everythin", "everything ", "Some"})
        EXPECT_EQ(tokens->find(none), nullptr) << none;
}

TEST_F(AccessTokensTest, AFileWithoutATokenOpensNothing) {
    for (const char* text : {"", "\n\n", "# only a comment\n"}) {
        const auto tokens = read(text);
        ASSERT_FALSE(tokens);
        EXPECT_EQ(tokens.error().code, ErrorCode::kInvalid);
        EXPECT_THAT(tokens.error().message, HasSubstr(file_.path().string()));
    }
    EXPECT_EQ(AccessTokens::read(file_.path() / "none").error().code, ErrorCode::kIo);
    EXPECT_FALSE(AccessTokens::read(file_.path().parent_path())) << "a folder";
}

TEST_F(AccessTokensTest, NamesTheLineThatIsWrongButNeverTheToken) {
    for (const std::string& line :
         {std::string("hush tiny%zz"), std::string(AccessTokens::kMaxTokenBytes + 1, 'h')}) {
        const auto tokens = read("good\n" + line + "\n");
        ASSERT_FALSE(tokens);
        EXPECT_THAT(tokens.error().message, HasSubstr("line 2"));
        EXPECT_THAT(tokens.error().message, Not(HasSubstr("hhh")));
        EXPECT_THAT(tokens.error().message, Not(HasSubstr("hush")));
    }
    EXPECT_TRUE(read(std::string(AccessTokens::kMaxTokenBytes, 'h') + "\n"));
}

TEST_F(AccessTokensTest, TheFirstOfTwoLinesWithOneTokenCounts) {
    const auto tokens = read("same tiny\nsame plume\n");
    ASSERT_TRUE(tokens);
    EXPECT_THAT(tokens->find("same")->datasets, ElementsAre("tiny"));
}

TEST_F(AccessTokensTest, ComparesWholeTokens) {
    EXPECT_TRUE(tokensMatch("secret", "secret"));
    const std::string expected = "secret";
    for (std::size_t i = 0; i < expected.size(); ++i) {
        std::string wrong = expected;
        wrong[i] = char(wrong[i] ^ 1);
        EXPECT_FALSE(tokensMatch(expected, wrong)) << i;
        EXPECT_FALSE(tokensMatch(expected, expected.substr(0, i))) << i;
    }
    // A whole number of repetitions has the same bytes at every place.
    EXPECT_FALSE(tokensMatch("ab", "abab"));
    EXPECT_FALSE(tokensMatch("abab", "ab"));
    EXPECT_FALSE(tokensMatch("", "a"));
    EXPECT_FALSE(tokensMatch("a", ""));
    EXPECT_FALSE(tokensMatch(std::string("a\0", 2), "a"));
}

// No early end: the last of many tokens is found, and nothing differs for a wrong first or a wrong last byte
// but the answer. (A measurement of time would fail on a busy machine; the loops have no way out to test.)
TEST_F(AccessTokensTest, LooksAtEveryToken) {
    std::string text;
    for (int i = 0; i < 500; ++i) text += "token" + std::to_string(i) + " dataset" + std::to_string(i) + "\n";
    const auto tokens = read(text);
    ASSERT_TRUE(tokens);
    for (int i = 0; i < 500; ++i) {
        const Access* found = tokens->find("token" + std::to_string(i));
        ASSERT_NE(found, nullptr) << i;
        EXPECT_THAT(found->datasets, ElementsAre("dataset" + std::to_string(i)));
    }
}

}  // namespace
}  // namespace brickyard
