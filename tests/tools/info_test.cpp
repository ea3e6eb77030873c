// What `info` shows of a field whose values are known.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <png.h>

#include <nlohmann/json.hpp>

#include "command_run.h"
#include "sample_grids.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

// Grey of a pixel that is all three, by row from the top.
struct Shades {
    int width = 0, height = 0;
    std::vector<std::uint8_t> rgb;
    std::array<int, 3> at(int column, int row) const {
        const std::size_t i = 3 * (std::size_t(row) * std::size_t(width) + std::size_t(column));
        return {rgb[i], rgb[i + 1], rgb[i + 2]};
    }
};

Shades readPng(const std::string& file) {
    png_image image{};
    image.version = PNG_IMAGE_VERSION;
    EXPECT_TRUE(png_image_begin_read_from_file(&image, file.c_str()));
    image.format = PNG_FORMAT_RGB;
    Shades shades{int(image.width), int(image.height), std::vector<std::uint8_t>(PNG_IMAGE_SIZE(image))};
    EXPECT_TRUE(png_image_finish_read(&image, nullptr, shades.rgb.data(), 0, nullptr));
    return shades;
}

class InfoTest : public testing::Test {
protected:
    InfoTest() {
        openvdb::initialize();
        // 30 x 20 x 10 voxels from (-5, 3, 100); 1 + x + 4 y + 8 z tells where a pixel comes from.
        auto grid = openvdb::FloatGrid::create(0);
        grid->setName("density");
        for (int z = 0; z < 10; ++z)
            for (int y = 0; y < 20; ++y)
                for (int x = 0; x < 30; ++x)
                    grid->tree().setValueOn(openvdb::Coord(x - 5, y + 3, z + 100),
                                            float(1 + x + 4 * y + 8 * z));
        auto signed_grid = openvdb::FloatGrid::create(0);
        signed_grid->setName("pressure");
        signed_grid->tree().setValueOn(openvdb::Coord(0, 0, 0), -2.f);
        signed_grid->tree().setValueOn(openvdb::Coord(1, 0, 0), 0.f);
        signed_grid->tree().setValueOn(openvdb::Coord(2, 0, 0), 1.f);
        writeGrids(scratch_ / "a.1.vdb", {grid, signed_grid});
        run({"convert", (scratch_ / "a.1.vdb").string(), dataset()});
    }
    std::string dataset() const { return (scratch_ / "a.bricks").string(); }
    std::string picture() const { return (scratch_ / "slice.png").string(); }
    Outcome run(const std::vector<std::string>& arguments, int status = 0) {
        const Outcome outcome = runProgram(logs_.path(), BRICKYARD_COMMAND, arguments);
        EXPECT_EQ(outcome.status, status) << outcome.err;
        return outcome;
    }

    ScratchFolder scratch_, logs_;
};

TEST_F(InfoTest, ASliceShowsEachVoxelAtItsPlace) {
    // Value of voxel (x, y, z) of the box, as a shade of the range 0 .. 255.
    const auto shade = [](int x, int y, int z) { return 1 + x + 4 * y + 8 * z; };
    run({"info", dataset(), "--slice", "z=104", "-o", picture(), "--range", "0,255"});
    Shades z = readPng(picture());
    ASSERT_EQ(z.width, 30);
    ASSERT_EQ(z.height, 20);
    for (int x = 0; x < 30; ++x)
        for (int y = 0; y < 20; ++y) ASSERT_EQ(z.at(x, 19 - y)[0], shade(x, y, 4)) << x << " " << y;
    run({"info", dataset(), "--slice", "y=10", "-o", picture(), "--range", "0,255"});
    const Shades y = readPng(picture());
    ASSERT_EQ(y.width, 30);
    ASSERT_EQ(y.height, 10);
    EXPECT_EQ(y.at(7, 9 - 3)[1], shade(7, 7, 3));
    run({"info", dataset(), "--slice", "x=-5", "-o", picture(), "--range", "0,255"});
    const Shades x = readPng(picture());
    ASSERT_EQ(x.width, 20);
    ASSERT_EQ(x.height, 10);
    EXPECT_EQ(x.at(11, 0)[2], shade(0, 11, 9));
    const Outcome beside = run({"info", dataset(), "--slice", "z=99", "-o", picture()}, 1);
    EXPECT_THAT(beside.err, HasSubstr("from 100 to 109"));
    run({"info", dataset(), "--slice", "w=99", "-o", picture()}, 2);
}

TEST_F(InfoTest, ValuesOfBothSignsAreBlueAndRedWithWhiteAtZero) {
    run({"info", dataset(), "--channel", "pressure", "--slice", "z=0", "-o", picture()});
    const Shades shades = readPng(picture());
    ASSERT_EQ(shades.width, 3);
    const auto low = shades.at(0, 0), zero = shades.at(1, 0), high = shades.at(2, 0);
    EXPECT_GT(low[2], low[0] + 100) << "blue";
    EXPECT_GT(high[0], high[2]) << "red";
    EXPECT_EQ(zero[0], zero[2]);
    EXPECT_GT(zero[0], 240);
}

TEST_F(InfoTest, AHistogramCountsEveryActiveVoxelOnce) {
    const Outcome outcome = run({"info", dataset(), "--json", "--bins", "7", "--channel", "density"});
    const auto json = nlohmann::json::parse(outcome.out);
    const auto& histogram = json["frames"][0]["channels"][0]["histogram"];
    EXPECT_EQ(histogram["level"], 0);
    EXPECT_EQ(histogram["lowest"], 1);
    EXPECT_EQ(histogram["highest"], 178);
    ASSERT_EQ(histogram["voxels"].size(), 7u);
    std::vector<std::uint64_t> expected(7, 0);
    for (int z = 0; z < 10; ++z)
        for (int y = 0; y < 20; ++y)
            for (int x = 0; x < 30; ++x)
                ++expected[std::min<std::size_t>(6, std::size_t((x + 4 * y + 8 * z) * 7 / 177))];
    EXPECT_EQ(histogram["voxels"].get<std::vector<std::uint64_t>>(), expected);
}

TEST_F(InfoTest, ThePageIsAsWideAsAPage) {
    const Outcome outcome = run({"info", dataset()});
    EXPECT_THAT(outcome.out, HasSubstr("largest error"));
    for (std::size_t begin = 0, end = 0; begin < outcome.out.size(); begin = end + 1) {
        end = outcome.out.find('\n', begin);
        EXPECT_LE(end - begin, 100u) << outcome.out.substr(begin, end - begin);
    }
}

}  // namespace
}  // namespace brickyard
