// The example of docs/client.md, run as a user runs it: against a folder and against a server of it.
#include <gmock/gmock.h>

#include <array>
#include <cstdio>
#include <map>

#include "blob_field.h"
#include "client/brick_values.h"
#include "server/server.h"
#include "stored_fields.h"

namespace brickyard {
namespace {

using testing::HasSubstr;

class ReadBrickTest : public testing::Test {
protected:
    void SetUp() override {
        ASSERT_TRUE(storeFields(folder_ / "blob.bricks", {&field_}));
        ServerOptions options;
        options.port = 0;
        server_ = std::move(
            *Server::start(std::move(*Catalog::open({folder_ / "blob.bricks"}, 8, 1u << 20)), options));
        sources_ = {(folder_ / "blob.bricks").string(),
                    "ws://127.0.0.1:" + std::to_string(server_->port()) + "/blob"};
    }
    struct Run {
        int status = -1;
        std::string output;
    };
    static Run run(const std::string& arguments) {
        Run run;
        FILE* pipe = ::popen((std::string(BRICKYARD_READ_BRICK) + " " + arguments + " 2>&1").c_str(), "r");
        std::array<char, 4096> buffer;
        while (const std::size_t n = std::fread(buffer.data(), 1, buffer.size(), pipe))
            run.output.append(buffer.data(), n);
        run.status = WEXITSTATUS(::pclose(pipe));
        return run;
    }

    ScratchFolder folder_;
    const FormulaField field_ = roughBlobField();
    std::unique_ptr<Server> server_;
    std::vector<std::string> sources_;
};

TEST_F(ReadBrickTest, TheExamplePrintsWhatTheFieldIs) {
    for (const std::string& source : sources_) {
        const Run printed = run(source + " density 3 -5 7");
        ASSERT_EQ(printed.status, 0) << printed.output;
        std::map<long long, float> values;
        const char* text = printed.output.c_str();
        long long x = 0;
        float value = 0;
        int used = 0;
        for (; std::sscanf(text, "%lld %g%n", &x, &value, &used) == 2; text += used) values[x] = value;
        ASSERT_EQ(values.size(), 9u) << printed.output;
        EXPECT_TRUE(values.contains(3));
        for (const auto& [at, stored] : values)
            EXPECT_EQ(stored, float(field_.at(at, -5, 7))) << source << " x " << at;
    }
}

TEST_F(ReadBrickTest, TheExampleSaysWhatIsWrong) {
    for (const std::string& source : sources_) {
        const Run none = run(source + " heat 3 -5 7");
        EXPECT_EQ(none.status, 1);
        EXPECT_THAT(none.output, HasSubstr("no channel 'heat'; there are: density"));
        EXPECT_THAT(run(source + " density 100000 0 0").output, HasSubstr("background"));
    }
    EXPECT_EQ(run("nowhere.bricks density 0 0 0").status, 1);
    EXPECT_EQ(run("").status, 2);
}

TEST_F(ReadBrickTest, EveryLevelAndEveryPlaceComesFromItsBrick) {
    std::vector<std::vector<double>> both[2];
    for (int s = 0; s < 2; ++s) {
        auto source = std::move(*openSource(sources_[std::size_t(s)], ""));
        const auto footer = source->openFrame(0);
        ASSERT_TRUE(footer);
        for (int level = 0; level < 4; ++level)
            for (const std::int64_t x : {-21, -8, -1, 0, 8, 17}) {
                const auto brick = readBrick(*source, *footer, "density", {x, 2, -3}, level);
                if (!brick) {
                    EXPECT_EQ(brick.error().code, ErrorCode::kNotFound) << brick.error().message;
                    both[s].push_back({});
                    continue;
                }
                EXPECT_GE(brick->key.level, level);
                const auto origin = brick->origin();
                const std::int64_t edge = 8 * brick->stepVoxels();
                for (const auto& [p, a] : {std::pair<std::int64_t, int>{x, 0}, {2, 1}, {-3, 2}}) {
                    EXPECT_LE(origin[std::size_t(a)], p);
                    EXPECT_LT(p, origin[std::size_t(a)] + edge);
                }
                both[s].push_back(brick->samples);
                if (brick->key.level > 0) continue;
                for (int k = 0; k <= 8; ++k)
                    for (int j = 0; j <= 8; ++j)
                        for (int i = 0; i <= 8; ++i)
                            ASSERT_EQ(brick->at(i, j, k),
                                      field_.at(origin[0] + i, origin[1] + j, origin[2] + k));
            }
    }
    EXPECT_EQ(both[0], both[1]);
}

TEST_F(ReadBrickTest, KeepsItsDeadline) {
    auto source = std::move(*openSource(sources_[1], ""));
    const auto footer = source->openFrame(0);
    ASSERT_TRUE(footer);
    server_.reset();
    const auto late = readBrick(*source, *footer, "density", {0, 0, 0}, 0,
                                std::chrono::steady_clock::now() + std::chrono::milliseconds(200));
    ASSERT_FALSE(late);
    EXPECT_EQ(late.error().code, ErrorCode::kTimeout);
    EXPECT_THAT(late.error().message, HasSubstr("density"));
}

}  // namespace
}  // namespace brickyard
