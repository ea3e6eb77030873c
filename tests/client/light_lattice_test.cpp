// Lattices of light: against closed forms and single shadow rays, whatever the cache holds.
#include "client/cpu/light_lattice.h"

#include <gtest/gtest.h>

#include <random>

#include "blob_field.h"
#include "client/brick_page.h"
#include "client/cpu/packet_kernel.h"
#include "core/brick_codec.h"
#include "dense_light.h"
#include "stored_fields.h"

namespace brickyard {
namespace {

constexpr int kEdge = 8;

// A dataset in memory, lit; pages go into the cache one by one, as a renderer's loop would have it.
class LightLattices : public testing::Test {
protected:
    void store(const FieldSource& field, double density_scale, const glm::dvec3& to_light) {
        ASSERT_TRUE(storeFields(folder_ / "test.bricks", {&field}, kEdge));
        auto opened = BrickStore::open(folder_ / "test.bricks/frames/000000.brk");
        ASSERT_TRUE(opened) << opened.error().message;
        store_ = *opened;
        auto channel = PagedChannel::create(store_->footer().channels(0), 0, kEdge, store_->fileBytes());
        ASSERT_TRUE(channel) << channel.error().message;
        channel_.emplace(std::move(*channel));
        for (std::uint32_t b = 0; b < channel_->blockCount(); ++b) {
            const auto block = store_->readBlock(0, b);
            ASSERT_TRUE(block);
            ASSERT_TRUE(channel_->addBlock(b, *block));
        }
        plan_.density = &*channel_;
        plan_.scene.density_scale = density_scale;
        plan_.scene.light.emplace();
        plan_.scene.light->to_light = glm::normalize(to_light);
        cache_.emplace(64u << 20, pageFloats(channel_->shape()));
    }
    RayContext context() { return {&*cache_, &failed_, &wants_, 0, cache_->room()}; }

    // What is wanted arrives, as much of it as there is room for.
    void arrive() {
        cache_->beginPass();
        for (const auto& [wanted, want] : wants_.all()) {
            ASSERT_FALSE(wanted.is_block);
            if (cache_->contains(wanted.address)) continue;
            float* slot = cache_->insert(wanted.address);
            if (!slot) break;
            const NodeRecord& record = channel_->block(wanted.address.block)->record(wanted.address.node);
            const auto payload = store_->readPayload(record, "a brick");
            ASSERT_TRUE(payload);
            const SampleType type =
                levelType(channel_->type(), channel_->levelOf({wanted.address.block, wanted.address.node}));
            std::span<float> samples(slot, channel_->shape().samples());
            const auto bytes = std::span(*payload);
            ASSERT_TRUE(
                wanted.address.draft
                    ? decodeDraftToFloat(bytes.first(record.draft_bytes), channel_->shape(), type, 1, samples)
                    : decodeBrickToFloat(bytes, channel_->shape(), type, 1, samples));
            slot[samples.size()] = steepnessOf(samples, channel_->shape());
        }
        wants_.clear();
    }
    const LightLattice* finish(LightField& light, const WalkedNode& node) {
        for (int pass = 0; pass < 10000; ++pass) {
            if (const LightLattice* lattice = light.of(node, 1, context())) return lattice;
            EXPECT_FALSE(wants_.empty()) << "waits for nothing";
            arrive();
        }
        ADD_FAILURE() << "never done";
        return nullptr;
    }
    // Leaves with a brick.
    std::vector<WalkedNode> leaves() {
        std::vector<WalkedNode> out;
        std::vector<WalkedNode> open;
        for (std::size_t i = 0; i < channel_->roots().size(); ++i) {
            WalkedNode& root = open.emplace_back();
            root.key = channel_->roots()[i];
            root.ref = {0, std::uint32_t(i)};
        }
        while (!open.empty()) {
            WalkedNode node = open.back();
            open.pop_back();
            node.block = channel_->block(node.ref.block);
            if (!canDescend(node)) {
                if (node.record().hasBrick()) out.push_back(node);
                continue;
            }
            const ChildrenRef first = node.block->children(node.ref.node);
            std::uint32_t next = first.first;
            for (int octant = 0; octant < 8; ++octant) {
                if (!(node.block->validMask(node.ref.node) >> octant & 1)) continue;
                WalkedNode& child = open.emplace_back();
                child.key = node.key.child(octant);
                child.ref = {first.block, next++};
            }
        }
        return out;
    }
    glm::dvec3 pointOf(const WalkedNode& node, const LightLattice& lattice, int x, int y, int z) const {
        const glm::dvec3 steps(x, y, z);
        glm::dvec3 cells;
        for (int a = 0; a < 3; ++a) cells[a] = lattice.box_begin[a] + steps[a] / double(lattice.per_cell[a]);
        return nodeLow(node.key, channel_->shape()) + cellEdge(node.key.level) * cells;
    }
    template <class Visit>
    void forEachPoint(const WalkedNode& node, const LightLattice& lattice, Visit&& visit) const {
        for (int z = 0; z < lattice.points[2]; ++z)
            for (int y = 0; y < lattice.points[1]; ++y)
                for (int x = 0; x < lattice.points[0]; ++x) {
                    const int at = x + lattice.points[0] * (y + lattice.points[1] * z);
                    visit(pointOf(node, lattice, x, y, z), double(lattice.quads[std::size_t(4 * at)]));
                }
    }

    ScratchFolder folder_;
    std::shared_ptr<const BrickStore> store_;
    std::optional<PagedChannel> channel_;
    std::optional<PageCache> cache_;
    RenderPlan plan_;
    WantList wants_;
    std::unordered_set<WantedPage, WantedPageHash> failed_;
};

TEST_F(LightLattices, ASlabsDepthToTheLightIsTheWayOutOfIt) {
    const FormulaField slab("density", {{0, 0, 0}, {65, 65, 17}},
                            [](std::int64_t, std::int64_t, std::int64_t, int) { return 1.0; });
    const glm::dvec3 to_light = glm::normalize(glm::dvec3(0.3, -0.2, 1));
    store(slab, 0.125, to_light);
    LightField light(plan_, /*deviation=*/0);
    std::size_t tested = 0;
    for (const WalkedNode& node : leaves()) {
        const LightLattice* lattice = finish(light, node);
        ASSERT_TRUE(lattice);
        forEachPoint(node, *lattice, [&](const glm::dvec3& p, double depth) {
            // Not near the sides; and above 16 a ramp of one voxel leads down to 0.
            if (std::max(std::abs(p.x - 32), std::abs(p.y - 32)) > 20 || p.z < 0) return;
            const double above = p.z > 16 ? 0.5 * (17 - p.z) * (17 - p.z) : 16 - p.z + 0.5;
            EXPECT_NEAR(depth, 0.125 * above / to_light.z, 2e-6) << p.z;
            ++tested;
        });
        // Depth is linear between the points, so is what is looked up.
        const double inside = 4.3 / double(lattice->per_cell[2]);
        EXPECT_GT(lattice->transmittance(4, 4, inside), 0);
        EXPECT_LE(lattice->transmittance(4, 4, inside), 1);
    }
    EXPECT_GT(tested, 500u);
}

TEST_F(LightLattices, EveryPointHasTheDepthOfAShadowRay) {
    const FormulaField field = roughBlobField();
    const DenseLight truth(field);
    const glm::dvec3 ways[] = {{0.5, 0.6, -0.4}, {1, 1e-7, -1e-7}, {1e-12, -1, 1e-9}};
    for (const glm::dvec3& way : ways) {
        store(field, 0.05, way);
        const glm::dvec3 to_light = plan_.scene.light->to_light;
        LightField light(plan_, /*deviation=*/0);
        int nodes = 0;
        for (const WalkedNode& node : leaves()) {
            if (++nodes % 7) continue;
            const LightLattice* lattice = finish(light, node);
            ASSERT_TRUE(lattice);
            EXPECT_EQ(lattice->deviation, 0) << "of exact levels";
            int points = 0;
            forEachPoint(node, *lattice, [&](const glm::dvec3& p, double depth) {
                if (++points % 11) return;
                EXPECT_NEAR(depth, 0.05 * truth.depth({p, to_light}), 3e-6);
            });
        }
    }
}

TEST_F(LightLattices, DoublingEndsWhereTheErrorIsAllowedOrTheVoxelsEnd) {
    store(roughBlobField(), 0.2, {0.5, 0.6, -0.4});
    std::size_t points_before = SIZE_MAX, met = 0;
    for (const double deviation : {0.0, 1e-3, 1e-2, 0.1}) {
        LightField light(plan_, deviation);
        std::size_t points = 0;
        for (const WalkedNode& node : leaves()) {
            const LightLattice* lattice = finish(light, node);
            ASSERT_TRUE(lattice);
            bool finest = true;
            for (int a = 0; a < 3; ++a) {
                EXPECT_EQ(lattice->points[a] % 2, 1);
                EXPECT_GE(lattice->points[a], 3);
                EXPECT_LE(lattice->points[a], kMostLightCells + 1);
                const auto axis = std::size_t(a);
                const int cells = node.record().box_end[axis] - node.record().box_begin[axis];
                finest &= lattice->points[a] - 1 >= cells;
            }
            // Where it is coarser than the voxels, twice the deviation was enough; tails count for more than
            // the rule does.
            if (!finest && deviation > 0) {
                EXPECT_LE(double(lattice->spacing_deviation), 6 * deviation);
                ++met;
            }
            points += std::size_t(lattice->points[0] * lattice->points[1] * lattice->points[2]);
        }
        EXPECT_LE(points, points_before) << "a larger error takes more points";
        points_before = points;
    }
    EXPECT_GT(met, 50u);
}

TEST_F(LightLattices, ATightCacheGivesTheSameLattices) {
    store(roughBlobField(), 0.05, {0.5, 0.6, -0.4});
    for (const double deviation : {0.0, 0.02}) {
        cache_.emplace(64u << 20, pageFloats(channel_->shape()));
        LightField ample(plan_, deviation);
        std::vector<const LightLattice*> expected;
        for (const WalkedNode& node : leaves()) expected.push_back(finish(ample, node));
        cache_.emplace(3 * sizeof(float) * pageFloats(channel_->shape()), pageFloats(channel_->shape()));
        LightField tight(plan_, deviation);
        std::size_t i = 0;
        for (const WalkedNode& node : leaves()) {
            const LightLattice* expect = expected[i++];
            if (i % 9) continue;
            const LightLattice* lattice = finish(tight, node);
            ASSERT_TRUE(lattice && expect);
            EXPECT_EQ(lattice->quads, expect->quads);
            EXPECT_EQ(lattice->deviation, expect->deviation);
            EXPECT_EQ(lattice->spacing_deviation, expect->spacing_deviation);
        }
        EXPECT_GT(cache_->reloads(), 0u) << "the cache was not tight";
    }
}

TEST_F(LightLattices, WithWhatIsResidentNoneWaitsAndNothingIsWanted) {
    store(roughBlobField(), 0.05, {0.5, 0.6, -0.4});
    std::mt19937 random(1);
    const std::vector<WalkedNode> nodes = leaves();
    for (int round = 0; round < 3; ++round) {
        const ResidentTree tree(*channel_, [&](const PageAddress& page) { return cache_->contains(page); });
        LightField light(plan_, 0.01, &tree);
        for (const WalkedNode& node : nodes) {
            const LightLattice* lattice = light.of(node, 1, context());
            ASSERT_TRUE(lattice) << "round " << round;
            for (float depth : lattice->quads) EXPECT_TRUE(std::isfinite(depth) && depth >= 0);
        }
        EXPECT_TRUE(wants_.empty());
        // Some pages arrive.
        for (const WalkedNode& node : nodes)
            if (random() % 3 == 0) wants_.add({false, {0, node.ref.block, node.ref.node, false}}, 1, 1, 0);
        arrive();
    }
    EXPECT_GT(cache_->size(), 10u);
}

}  // namespace
}  // namespace brickyard
