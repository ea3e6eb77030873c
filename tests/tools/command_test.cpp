#include "tools/command.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdint>

namespace brickyard {
namespace {

using testing::HasSubstr;

TEST(ParseSize, CountsInPowersOf1024) {
    EXPECT_EQ(parseSize("65536"), 65536u);
    EXPECT_EQ(parseSize("7B"), 7u);
    EXPECT_EQ(parseSize("512K"), 512u << 10);
    EXPECT_EQ(parseSize("512M"), 512u << 20);
    EXPECT_EQ(parseSize("3g"), std::uint64_t{3} << 30);
    EXPECT_EQ(parseSize("2TiB"), std::uint64_t{2} << 40);
    EXPECT_EQ(parseSize("1.5G"), std::uint64_t{3} << 29);
    EXPECT_EQ(parseSize("0.5K"), 512u);
    EXPECT_EQ(parseSize("0"), 0u);
}

TEST(ParseSize, KeepsEveryDigitOfAWholeNumber) {
    EXPECT_EQ(parseSize("9007199254740993"), 9007199254740993u);
    EXPECT_EQ(parseSize("18446744073709551615"), UINT64_MAX);
}

TEST(ParseSize, RefusesWhatIsNoSizeAndSaysHowToWriteOne) {
    for (const char* text :
         {"", "M", "-1", "+1", "1.2.3", "12X", "1Kx", "1KiBs", " 1", "1 K", "1e3", "nan", "inf", "0x10",
          "18446744073709551616", "18014398509481984K", "16777216T", "99999999999.5T"}) {
        const auto size = parseSize(text);
        ASSERT_FALSE(size) << "'" << text << "' was read as " << *size;
        EXPECT_EQ(size.error().code, ErrorCode::kInvalid);
        EXPECT_THAT(size.error().message, HasSubstr("for example 512M"));
        EXPECT_THAT(size.error().message, HasSubstr(std::string("'") + text + "'"));
    }
}

TEST(ReportError, WritesOneLineAndGivesTheStatusOfAFailure) {
    testing::internal::CaptureStderr();
    EXPECT_EQ(reportError("info", Error{ErrorCode::kNotFound, "x.bricks: no such folder"}), kExitFailed);
    EXPECT_EQ(testing::internal::GetCapturedStderr(), "brickyard info: x.bricks: no such folder\n");
}

}  // namespace
}  // namespace brickyard
