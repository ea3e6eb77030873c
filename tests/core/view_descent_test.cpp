#include "core/view_descent.h"

#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <set>

#include "core/dataset.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

// A channel of 5 levels over [0, 128)^3, looked at from outside or inside.
class ViewDescentTest : public testing::Test {
protected:
    static void SetUpTestSuite() { tiny_ = new TinyDataset("tiny", {.levels = 5}); }
    static void TearDownTestSuite() { delete tiny_; }

    void SetUp() override { store_ = tiny_->store(); }

    static PinholeCamera look(std::vector<double> eye, std::vector<double> target,
                              std::uint32_t pixels = 256) {
        Camera camera;
        camera.mutable_eye()->Assign(eye.begin(), eye.end());
        camera.mutable_target()->Assign(target.begin(), target.end());
        return *PinholeCamera::create(camera, pixels, pixels);
    }

    std::vector<DescentStep> describe(const PinholeCamera& camera,
                                      DescentLimits limits = {.max_bytes = 1u << 30}) {
        const auto load = [&](std::uint32_t block) -> Result<std::shared_ptr<const TreeBlock>> {
            auto loaded = store_->loadBlock(0, block);
            if (!loaded) return tl::unexpected(loaded.error());
            return std::make_shared<const TreeBlock>(std::move(*loaded));
        };
        auto steps = describeView(camera, store_->footer().channels(0), 0, 8, load, limits);
        EXPECT_TRUE(steps) << steps.error().message;
        return steps ? *steps : std::vector<DescentStep>{};
    }

    // Level and place of every node, walked from the root without the code under test.
    std::map<std::pair<std::uint32_t, std::uint32_t>, NodeKey> keys() {
        std::map<std::pair<std::uint32_t, std::uint32_t>, NodeKey> found;
        std::vector<TreeBlock> blocks;
        for (int b = 0; b < store_->footer().channels(0).blocks_size(); ++b)
            blocks.push_back(*store_->loadBlock(0, std::uint32_t(b)));
        std::vector<std::tuple<std::uint32_t, std::uint32_t, NodeKey>> open{{0, 0, {4, 0, 0, 0}}};
        while (!open.empty()) {
            const auto [block, node, key] = open.back();
            open.pop_back();
            found[{block, node}] = key;
            if (blocks[block].isLeaf(node)) continue;
            const ChildrenRef children = blocks[block].children(node);
            std::uint32_t child = children.first;
            for (int o = 0; o < 8; ++o)
                if (blocks[block].validMask(node) >> o & 1)
                    open.emplace_back(children.block, child++, key.child(o));
        }
        return found;
    }

    static TinyDataset* tiny_;
    std::shared_ptr<const BrickStore> store_;
};
TinyDataset* ViewDescentTest::tiny_ = nullptr;

TEST_F(ViewDescentTest, BringsEveryBlockAndBrickOfAViewThatSeesAllOnce) {
    ASSERT_GT(tiny_->blockCount(0), 1u) << "the tree must be cut for this test to mean something";
    const auto steps = describe(look({64, 64, 400}, {64, 64, 64}, 16384));
    std::set<std::pair<std::uint32_t, std::uint32_t>> blocks, bricks;
    for (const DescentStep& step : steps) {
        auto& seen = step.is_block ? blocks : bricks;
        EXPECT_TRUE(seen.insert({step.page.block, step.page.node}).second) << "a step came twice";
        EXPECT_TRUE(step.is_block || blocks.contains({step.page.block, 0}))
            << "a brick came before its block";
    }
    EXPECT_TRUE(steps.front().is_block);
    EXPECT_EQ(blocks.size(), tiny_->blockCount(0));
    EXPECT_EQ(bricks.size(), tiny_->bricks(0).size());
}

TEST_F(ViewDescentTest, SendsParentsBeforeTheirChildren) {
    const auto where = keys();
    std::set<std::tuple<int, int, int, int>> sent;
    for (const DescentStep& step : describe(look({64, 64, 300}, {64, 64, 64}, 4096))) {
        if (step.is_block) continue;
        const NodeKey key = where.at({step.page.block, step.page.node});
        const NodeKey parent = key.parent();
        EXPECT_TRUE(key.level == 4 || sent.contains({parent.level, parent.x, parent.y, parent.z}))
            << toString(key);
        sent.insert({key.level, key.x, key.y, key.z});
    }
    EXPECT_FALSE(sent.empty());
}

TEST_F(ViewDescentTest, ACameraThatLooksAwayGetsNoBrick) {
    const auto steps = describe(look({64, 64, 400}, {64, 64, 800}));
    ASSERT_EQ(steps.size(), 1u);
    EXPECT_TRUE(steps[0].is_block);
}

TEST_F(ViewDescentTest, AFarCameraGetsCoarseLevelsOnly) {
    const auto where = keys();
    std::map<int, int> per_level;
    // 128 voxels far away are about 16 pixels: level 3 has a voxel per pixel.
    for (const DescentStep& step : describe(look({64, 64, 2800}, {64, 64, 64})))
        if (!step.is_block) ++per_level[where.at({step.page.block, step.page.node}).level];
    EXPECT_EQ(per_level[4], 1);
    EXPECT_EQ(per_level[3], 7);
    EXPECT_EQ(per_level[1] + per_level[0], 0);
}

// The reference is a sampled frustum: a node through whose region a pixel's ray passes must be there.
TEST_F(ViewDescentTest, LeavesNoNodeOutThatARayMeets) {
    const auto where = keys();
    for (const auto& eye : std::vector<std::vector<double>>{{64, 70, 60}, {-20, 10, 30}, {130, 130, 130}}) {
        const PinholeCamera camera = look(eye, {40, 50, 45}, 64);
        std::set<std::tuple<int, int, int, int>> sent;
        for (const DescentStep& step : describe(camera, {.pixels_per_voxel = 0.01f, .max_bytes = 1u << 30}))
            if (!step.is_block) {
                const NodeKey key = where.at({step.page.block, step.page.node});
                sent.insert({key.level, key.x, key.y, key.z});
            }
        EXPECT_LT(sent.size(), tiny_->bricks(0).size()) << "nothing was left out";
        for (std::uint32_t y = 0; y < 64; y += 3)
            for (std::uint32_t x = 0; x < 64; x += 3)
                for (double t = 0; t < 200; t += 1.5) {
                    const WorldRay ray = camera.ray(x, y);
                    const glm::dvec3 p = (ray.origin + ray.direction * t) / 8.0;
                    const glm::ivec3 at{int(std::floor(p.x)), int(std::floor(p.y)), int(std::floor(p.z))};
                    if (at.x < 0 || at.y < 0 || at.z < 0 || at.x > 15 || at.y > 15 || at.z > 15) continue;
                    if (at.x > 7 && at.y > 7 && at.z > 7) continue;  // the octant of one value
                    ASSERT_TRUE(sent.contains({0, at.x, at.y, at.z})) << at.x << ' ' << at.y << ' ' << at.z;
                }
    }
}

TEST_F(ViewDescentTest, StopsWithTheStepThatReachesTheLimit) {
    const PinholeCamera camera = look({64, 64, 400}, {64, 64, 64}, 16384);
    const auto all = describe(camera);
    std::uint64_t sum = 0;
    for (std::size_t n = 0; n < 40; ++n) {
        sum += all[n].bytes;
        const auto some = describe(camera, {.max_bytes = sum});
        ASSERT_EQ(some.size(), n + 1);
        EXPECT_EQ(some.back().page, all[n].page);
    }
}

TEST_F(ViewDescentTest, IsTheSameFarFromTheOrigin) {
    FrameFooter moved = store_->footer();
    const double far = 1099511627776;  // 2^40
    for (int a = 0; a < 3; ++a) moved.mutable_channels(0)->set_index_to_world(12 + a, far);
    const auto load = [&](std::uint32_t block) -> Result<std::shared_ptr<const TreeBlock>> {
        return std::make_shared<const TreeBlock>(*store_->loadBlock(0, block));
    };
    const auto here = describe(look({64, 70, 60}, {40, 50, 45}));
    const auto there = describeView(look({far + 64, far + 70, far + 60}, {far + 40, far + 50, far + 45}),
                                    moved.channels(0), 0, 8, load, {.max_bytes = 1u << 30});
    ASSERT_TRUE(there);
    ASSERT_EQ(there->size(), here.size());
    for (std::size_t i = 0; i < here.size(); ++i) EXPECT_EQ((*there)[i].page, here[i].page) << i;
}

TEST_F(ViewDescentTest, EndsWithTheErrorOfTheLoader) {
    const auto load = [&](std::uint32_t block) -> Result<std::shared_ptr<const TreeBlock>> {
        if (block > 0) return fail(ErrorCode::kIo, "no disk");
        return std::make_shared<const TreeBlock>(*store_->loadBlock(0, block));
    };
    const auto steps = describeView(look({64, 64, 400}, {64, 64, 64}, 16384), store_->footer().channels(0), 0,
                                    8, load, {.max_bytes = 1u << 30});
    ASSERT_FALSE(steps);
    EXPECT_EQ(steps.error().message, "no disk");
}

}  // namespace
}  // namespace brickyard
