#include "tools/frame_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "command_run.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;
using testing::HasSubstr;

class FramePlan : public testing::Test {
protected:
    void touch(const std::vector<std::string>& names) {
        for (const std::string& name : names) writeFile(scratch_ / name, "x");
    }
    std::string path(const std::string& name) const { return (scratch_ / name).string(); }
    // "18: a b, 24: c", with names instead of paths.
    std::string plan(std::vector<std::string> inputs) {
        for (std::string& input : inputs) input = path(input);
        const auto frames = planInputs(inputs);
        if (!frames) return frames.error().message;
        std::string text;
        for (const FrameInputs& frame : *frames) {
            text += (text.empty() ? "" : ", ") + std::to_string(frame.frame) + ":";
            for (const auto& file : frame.files) text += " " + file.filename().string();
        }
        return text;
    }
    ScratchFolder scratch_;
};

TEST_F(FramePlan, TheLastDigitsOfANameAreItsFrame) {
    EXPECT_EQ(frameNumber("plume.0018.vdb"), 18u);
    EXPECT_EQ(frameNumber("/2024/shot_12/smoke.vdb"), std::nullopt);
    EXPECT_EQ(frameNumber("v2_density_0100.vdb"), 100u);
    EXPECT_EQ(frameNumber("7.vdb"), 7u);
    EXPECT_EQ(frameNumber("take20261122130000.vdb"), std::nullopt);
    touch({"b.vdb", "x.0003.vdb", "a.vdb", "y.3.vdb"});
    EXPECT_EQ(plan({"b.vdb", "x.0003.vdb", "a.vdb", "y.3.vdb"}), "0: b.vdb, 1: a.vdb, 3: x.0003.vdb y.3.vdb");
}

TEST_F(FramePlan, APatternIsEveryFileThereIsOfASequence) {
    touch({"p.0009.vdb", "p.0010.vdb", "p.0123.vdb", "p.12345.vdb", "p.00012.vdb", "p.7.vdb",
           "p.0010.vdb.tmp", "p.x010.vdb", "q.0010.vdb", "p..vdb", "p.9999999999.vdb"});
    const std::string four = "9: p.0009.vdb, 10: p.0010.vdb, 123: p.0123.vdb, 12345: p.12345.vdb";
    EXPECT_EQ(plan({"p.%04d.vdb"}), four);
    EXPECT_EQ(plan({"p.####.vdb"}), four);
    EXPECT_EQ(plan({"p.$F4.vdb"}), four);
    EXPECT_EQ(plan({"p.%d.vdb"}), "7: p.7.vdb, 12345: p.12345.vdb");
    EXPECT_EQ(plan({"p.$F.vdb"}), "7: p.7.vdb, 12345: p.12345.vdb");
    EXPECT_EQ(plan({"p.001*.vdb"}), "10: p.0010.vdb");
    EXPECT_EQ(plan({"p.%04d.vdb", "q.%04d.vdb"}),
              "9: p.0009.vdb, 10: p.0010.vdb q.0010.vdb, 123: p.0123.vdb, 12345: p.12345.vdb");
}

TEST_F(FramePlan, TheNumberIsWhereThePatternHasIt) {
    touch({"p.0010.v2.vdb", "p.0011.v2.vdb", "100%d.vdb", "a#1.vdb"});
    EXPECT_EQ(plan({"p.%04d.v2.vdb"}), "10: p.0010.v2.vdb, 11: p.0011.v2.vdb");
    EXPECT_EQ(plan({"100%d.vdb"}), "100: 100%d.vdb") << "a file of that name is no pattern";
    EXPECT_EQ(plan({"a#1.vdb"}), "1: a#1.vdb");
}

TEST_F(FramePlan, WhatIsMissingIsNamed) {
    for (const char* missing :
         {"a.vdb", "*.vdb", "a.%04d.vdb", "a.####.vdb", "none/a.%d.vdb", "a.%s.vdb", "a.%", "$F"})
        EXPECT_THAT(plan({missing}), HasSubstr(missing));
}

TEST_F(FramePlan, FrameListsAreRangesWithSteps) {
    const auto listed = [](const std::string& text) {
        const auto set = FrameSet::parse(text);
        EXPECT_TRUE(set) << text;
        std::vector<std::uint32_t> frames;
        for (std::uint32_t i = 0; set && i < 30; ++i)
            if (set->contains(i)) frames.push_back(i);
        return frames;
    };
    EXPECT_THAT(listed("10-13"), ElementsAre(10, 11, 12, 13));
    EXPECT_THAT(listed("1,5,10-20:4"), ElementsAre(1, 5, 10, 14, 18));
    EXPECT_THAT(listed("7-7,3"), ElementsAre(3, 7));
    EXPECT_TRUE(FrameSet::parse("0-999999999")->contains(999'999'999));
    for (const char* wrong :
         {"", ",", "1,", "a", "3-1", "1-", "-1", "1-2:0", "1-2:", "1 2", "9999999999", "1-2-3", "1:"})
        EXPECT_FALSE(FrameSet::parse(wrong)) << wrong;
}

TEST_F(FramePlan, TheFirstFrameThatIsMissingIsFoundWithoutCountingThemAll) {
    const std::set<std::uint32_t> there{3, 4, 5, 7, 9};
    const auto missing = [&](const char* text) { return FrameSet::parse(text)->firstMissing(there); };
    EXPECT_EQ(missing("3-5,7"), std::nullopt);
    EXPECT_EQ(missing("5-9x2"), std::nullopt);
    EXPECT_EQ(missing("7,3-999999999"), 6u);
    EXPECT_EQ(missing("999999999,3-5,1"), 1u);
    // A step that leads beyond the last number.
    EXPECT_EQ(missing("9-999999999x999999999"), std::nullopt);
    EXPECT_FALSE(FrameSet::parse("3x"));
    EXPECT_FALSE(FrameSet::parse("3-5x0"));
}

TEST_F(FramePlan, PartsOfASequenceConvertOneByOneIntoOneDataset) {
    const ScratchFolder logs;
    for (int frame = 1; frame <= 5; ++frame)
        writeFile(scratch_ / ("p.000" + std::to_string(frame) + ".raw"), std::string(8, char(frame)));
    const auto part = [&](const std::string& frames) {
        return runCommand(logs.path(), {"convert", path("p.%04d.raw"), path("out.bricks"), "--raw",
                                        "2x2x2:uint8", "--frames", frames});
    };
    const auto frames = [&] {
        std::string text;
        const auto dataset = Dataset::open(scratch_ / "out.bricks");
        for (const auto& entry : dataset->manifest().frames()) text += std::to_string(entry.frame()) + " ";
        return text;
    };
    EXPECT_EQ(part("2-3").status, 0);
    EXPECT_EQ(frames(), "2 3 ");
    const auto second = part("1,5-100");
    EXPECT_EQ(second.status, 0) << second.err;
    EXPECT_EQ(frames(), "1 2 3 5 ");
    const auto again = part("1-5:2");
    EXPECT_EQ(again.status, 0) << again.err;
    EXPECT_THAT(again.out, HasSubstr("3 frames (3 there already)"));
    expectOneLineOf(part("100"), "--frames");
    EXPECT_EQ(part("5-1").status, 2);
    const auto all =
        runCommand(logs.path(), {"convert", path("p.####.raw"), path("out.bricks"), "--raw", "2x2x2:uint8"});
    EXPECT_EQ(all.status, 0) << all.err;
    EXPECT_EQ(frames(), "1 2 3 4 5 ");
}

}  // namespace
}  // namespace brickyard
