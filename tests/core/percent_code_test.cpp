#include "core/percent_code.h"

#include <gtest/gtest.h>

namespace brickyard {
namespace {

TEST(PercentCode, BringsEveryByteButZeroBack) {
    std::string text;
    for (int c = 1; c < 256; ++c) text += char(c);
    const std::string encoded = percentEncode(text);
    for (const char c : encoded) EXPECT_TRUE(c > ' ' && c <= '~' && c != '/') << int(c);
    EXPECT_EQ(percentDecode(encoded).value(), text);
}

TEST(PercentCode, RefusesWhatIsCutOrNotHex) {
    for (const char* bad : {"%", "%1", "a%", "%zz", "%1g", "%+1", "%00"})
        EXPECT_FALSE(percentDecode(bad)) << bad;
    EXPECT_EQ(percentDecode("%2e%2E").value(), "..");
}

}  // namespace
}  // namespace brickyard
