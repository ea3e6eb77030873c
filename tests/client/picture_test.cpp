// Picture files and the box filter.
#include "client/picture.h"

#include <gmock/gmock.h>

#include <cstring>

#include "frame_fixture.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

Picture numberedPicture(std::uint32_t width, std::uint32_t height) {
    Picture picture(width, height);
    float number = 0.25f;
    for (Pixel& p : picture.pixels) {
        p.radiance = {number, 2 * number, 3 * number};
        p.alpha = number / 64;
        p.depth = 100 + number;
        p.bound_alpha = p.bound_radiance = number / 8;
        p.estimate_alpha = p.estimate_radiance = number / 16;
        number += 1;
    }
    return picture;
}

TEST(PictureTest, AnExrComesBackAsItWasWritten) {
    const ScratchFolder folder;
    const Picture picture = numberedPicture(5, 3);
    ASSERT_TRUE(writeExr(picture, folder / "a.exr"));
    const auto read = readExr(folder / "a.exr");
    ASSERT_TRUE(read) << read.error().message;
    ASSERT_EQ(read->width, 5u);
    ASSERT_EQ(read->height, 3u);
    EXPECT_EQ(std::memcmp(read->pixels.data(), picture.pixels.data(), 15 * sizeof(Pixel)), 0);
}

TEST(PictureTest, AFileThatIsNoExrIsOneLine) {
    const ScratchFolder folder;
    writeFile(folder / "a.exr", "P5 2 2 255\n....");
    const auto read = readExr(folder / "a.exr");
    ASSERT_FALSE(read);
    EXPECT_THAT(read.error().message, HasSubstr("a.exr"));
    EXPECT_EQ(readExr(folder / "none.exr").error().code, ErrorCode::kNotFound);

    ASSERT_TRUE(writeExr(numberedPicture(64, 64), folder / "b.exr"));
    const std::string whole = readFile(folder / "b.exr");
    for (const std::size_t bytes : {std::size_t(3), std::size_t(40), whole.size() / 2}) {
        writeFile(folder / "cut.exr", whole.substr(0, bytes));
        EXPECT_FALSE(readExr(folder / "cut.exr")) << bytes << " of " << whole.size() << " bytes";
    }
}

TEST(PictureTest, ABoxFilteredPixelIsTheMeanOfItsSamples) {
    const Picture picture = numberedPicture(4, 2);
    const Picture half = boxFiltered(picture, 2);
    ASSERT_EQ(half.width, 2u);
    ASSERT_EQ(half.height, 1u);
    // Pixel 1 comes of numbers 2, 3, 6 and 7, each and a quarter.
    const Pixel& p = half.pixels[1];
    EXPECT_EQ(p.radiance[2], 3 * 4.75f);
    EXPECT_EQ(p.alpha, 4.75f / 64);
    EXPECT_EQ(p.bound_alpha, 4.75f / 8);
    const double weighted = 2.25 * 102.25 + 3.25 * 103.25 + 6.25 * 106.25 + 7.25 * 107.25;
    EXPECT_NEAR(double(p.depth), weighted / 19, 1e-4);
}

TEST(PictureTest, AnEmptyPixelHasNoDepthAfterTheFilter) {
    const Picture half = boxFiltered(Picture(2, 2), 2);
    EXPECT_EQ(half.pixels[0].depth, 0);
    EXPECT_EQ(half.pixels[0].alpha, 0);
}

}  // namespace
}  // namespace brickyard
