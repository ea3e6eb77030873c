// Plans of pages over real datasets of fields with known answers: what matters more comes sooner, hidden
// things do not come, drafts come before bricks, and a budget is a budget.
#include "client/cpu/page_order.h"

#include <gmock/gmock.h>

#include <algorithm>
#include <cmath>
#include <unordered_set>

#include "blob_field.h"
#include "frame_fixture.h"

namespace brickyard {
namespace {

// Rough enough that every level adds something: a fixed hash in [0, 1).
double grain(std::int64_t x, std::int64_t y, std::int64_t z) {
    std::uint64_t h = std::uint64_t(x) * 0x9e3779b97f4a7c15ull ^ std::uint64_t(y) * 0xbf58476d1ce4e5b9ull ^
                      std::uint64_t(z) * 0x94d049bb133111ebull;
    h = (h ^ (h >> 29)) * 0xbf58476d1ce4e5b9ull;
    return double(h >> 40) / double(1 << 24);
}

class PageOrderTest : public testing::Test {
protected:
    static constexpr int kSize = 48;

    // Stores the field with bricks of 8 cells; nothing of it has arrived.
    void store(const FieldSource& field) {
        auto writer = FrameWriter::create(folder_ / "frame.brk");
        ASSERT_TRUE(writer);
        BuildOptions options;
        options.shape.edge_cells = 8;
        const FieldSource* source = &field;
        auto footer = buildFrame({&source, 1}, {&options, 1}, **writer);
        ASSERT_TRUE(footer) << footer.error().message;
        ASSERT_TRUE((*writer)->finish(*footer));
        auto opened = BrickStore::open(folder_ / "frame.brk");
        ASSERT_TRUE(opened) << opened.error().message;
        store_ = *opened;
        auto channel = PagedChannel::create(store_->footer().channels(0), 0, 8, store_->fileBytes());
        ASSERT_TRUE(channel) << channel.error().message;
        channel_.emplace(std::move(*channel));
        resident_.clear();
    }
    void look(glm::dvec3 eye, glm::dvec3 target) {
        Camera c;
        for (int a = 0; a < 3; ++a) c.add_eye(eye[a]), c.add_target(target[a]), c.add_up(a == 1);
        c.set_vertical_fov_degrees(40);
        camera_.emplace(*PinholeCamera::create(c, kSize, kSize));
    }
    PagePlan plan() const {
        const ResidentTree tree(*channel_, [&](const PageAddress& page) { return resident_.contains(page); });
        return planPages(*channel_, *camera_, tree, request_);
    }
    void arrive(const PagePlan& plan) {
        for (const PlannedPage& page : plan.pages) {
            if (!page.page.is_block) {
                resident_.insert(page.page.address);
                continue;
            }
            const auto stored = store_->readBlock(0, page.page.address.block);
            ASSERT_TRUE(stored);
            ASSERT_TRUE(channel_->addBlock(page.page.address.block, *stored));
        }
    }
    // Topology and roots.
    void begin() {
        request_.batch_bytes = 1;
        for (int i = 0; i < 2; ++i) arrive(plan());
        request_.batch_bytes = 1u << 30;
    }
    const NodeRecord& record(const PlannedPage& page) const {
        return channel_->block(page.page.address.block)->record(page.page.address.node);
    }
    // Middle of a page's node in index space, found by walking down to it.
    glm::dvec3 middleOf(const PageAddress& page) const {
        std::vector<std::pair<NodeRef, NodeKey>> open;
        for (std::uint32_t i = 0; i < channel_->roots().size(); ++i)
            open.push_back({NodeRef{0, i}, channel_->roots()[i]});
        while (!open.empty()) {
            const auto [ref, key] = open.back();
            open.pop_back();
            if (ref == NodeRef{page.block, page.node})
                return nodeLow(key, channel_->shape()) + 0.5 * nodeEdge(key, channel_->shape());
            const TreeBlock* block = channel_->block(ref.block);
            if (!block || block->isLeaf(ref.node)) continue;
            ChildrenRef child = block->children(ref.node);
            for (int o = 0; o < 8; ++o)
                if (block->validMask(ref.node) >> o & 1)
                    open.push_back({NodeRef{child.block, child.first++}, key.child(o)});
        }
        ADD_FAILURE() << "no such page";
        return {};
    }

    ScratchFolder folder_;
    std::shared_ptr<const BrickStore> store_;
    std::optional<PagedChannel> channel_;
    std::optional<PinholeCamera> camera_;
    std::unordered_set<PageAddress, PageAddressHash> resident_;
    PlanRequest request_;
};

// Off the origin, where up to eight roots would meet.
FormulaField roughBox(std::int64_t edge = 32) {
    return FormulaField(
        "density", {{4, 4, 4}, {edge, edge, edge}},
        [](std::int64_t x, std::int64_t y, std::int64_t z, int) { return 0.1 + grain(x, y, z); });
}

TEST_F(PageOrderTest, AsksForTheTopFirst) {
    store(roughBox());
    look({16, 16, -60}, {16, 16, 16});
    request_.batch_bytes = 1;
    const PagePlan first = plan();
    ASSERT_EQ(first.pages.size(), 1u);
    EXPECT_EQ(first.pages[0].page, (WantedPage{true, {0, 0, 0}}));
    EXPECT_EQ(first.bytes, channel_->blockBytes(0));
    arrive(first);
    const PagePlan second = plan();
    ASSERT_EQ(second.pages.size(), 1u);
    EXPECT_EQ(second.pages[0].page, (WantedPage{false, {0, 0, 0, false}}))
        << "the root comes before all else";
}

TEST_F(PageOrderTest, EndsWhenNothingIsLeft) {
    store(roughBox());
    look({16, 16, -60}, {16, 16, 16});
    request_.batch_bytes = 4096;
    double error = 1e300;
    int plans = 0;
    for (;; ++plans) {
        ASSERT_LT(plans, 1000);
        const PagePlan next = plan();
        if (next.pages.empty()) break;
        if (plans > 1) {
            EXPECT_LE(next.error_before, error * (1 + 1e-9));
            EXPECT_LT(next.error_after, next.error_before);
            error = next.error_after;
        }
        for (const PlannedPage& page : next.pages)
            EXPECT_FALSE(resident_.contains(page.page.address)) << "asked for twice";
        arrive(next);
    }
    EXPECT_GT(plans, 5);
    EXPECT_EQ(plan().error_before, 0) << "all that is seen is exact";
}

TEST_F(PageOrderTest, DraftsComeBeforeTheirBricks) {
    store(roughBox());
    look({16, 16, -60}, {16, 16, 16});
    begin();
    std::unordered_set<std::uint32_t> drafts;
    std::size_t bricks = 0;
    for (const PlannedPage& page : plan().pages) {
        if (page.page.is_block || !record(page).hasDraft()) continue;
        if (page.page.address.draft) {
            EXPECT_EQ(page.bytes, record(page).draft_bytes);
            drafts.insert(page.page.address.node);
        } else {
            EXPECT_EQ(page.bytes, record(page).payload_bytes);
            EXPECT_TRUE(drafts.contains(page.page.address.node));
            ++bricks;
        }
    }
    EXPECT_GT(drafts.size(), 0u);
    EXPECT_GT(bricks, 0u);
}

TEST_F(PageOrderTest, LeavesOutWhatIsBehindOpaquePixels) {
    store(roughBox());
    look({16, 16, -60}, {16, 16, 16});
    begin();
    // The left half of the picture is opaque; the camera looks along +z with y up, so that is where x is
    // large.
    std::vector<float> transmittance(kSize * kSize, 1.0f);
    for (std::size_t i = 0; i < transmittance.size(); ++i)
        if (i % kSize < kSize / 2) transmittance[i] = 0;
    request_.transmittance = transmittance;
    const double sign = camera_->right().x > 0 ? 1 : -1;
    std::size_t pages = 0;
    for (const PlannedPage& page : plan().pages) {
        const glm::dvec3 middle = middleOf(page.page.address);
        EXPECT_GT(sign * (middle.x - 16), -17) << "a page wholly behind opaque pixels";
        if (middleOf(page.page.address).z < 4) EXPECT_GT(sign * (middle.x - 16), -5);
        ++pages;
    }
    EXPECT_GT(pages, 0u);

    std::fill(transmittance.begin(), transmittance.end(), 0.0f);
    EXPECT_TRUE(plan().pages.empty()) << "nothing can be seen";
}

TEST_F(PageOrderTest, BusyPartsComeBeforeCalmOnesOfTheSameSize) {
    // Two boxes side by side: a smooth one, and one of grain as high.
    store(FormulaField("density", {{4, 4, 4}, {60, 32, 32}},
                       [](std::int64_t x, std::int64_t y, std::int64_t z, int) {
                           return x < 32 ? 0.5 + 0.3 * std::sin(0.1 * double(x + y + z)) : grain(x, y, z);
                       }));
    look({32, 16, -90}, {32, 16, 16});
    begin();
    const PagePlan all = plan();
    std::size_t busy_first = 0, looked = 0;
    for (const PlannedPage& page : all.pages) {
        if (page.page.is_block || ++looked > 8) continue;
        busy_first += middleOf(page.page.address).x > 30;
    }
    // The calm box has sharp faces, which count too.
    EXPECT_GE(busy_first, 6u) << "of the first 8 pages";

    // The order by size does not tell them apart: as many pages of either side among the first.
    request_.order = PageOrder::kProjectedSize;
    std::size_t busy = 0;
    looked = 0;
    for (const PlannedPage& page : plan().pages) {
        if (page.page.is_block || ++looked > 20) continue;
        busy += middleOf(page.page.address).x > 34;
    }
    EXPECT_LT(busy, 15u);
}

TEST_F(PageOrderTest, NearBricksComeBeforeFarOnesOfTheSameField) {
    store(roughBox(64));
    look({32, 32, -20}, {32, 32, 32});
    begin();
    for (PageOrder order : {PageOrder::kErrorPerByte, PageOrder::kProjectedSize}) {
        request_.order = order;
        const PagePlan all = plan();
        double near = 0, far = 0;
        std::size_t first = 0, last = 0;
        for (std::size_t i = 0; i < all.pages.size(); ++i) {
            if (channel_->levelOf({all.pages[i].page.address.block, all.pages[i].page.address.node}) != 0 ||
                !all.pages[i].page.address.draft)
                continue;
            const double z = middleOf(all.pages[i].page.address).z;
            if (z < 16) near += double(i), ++first;
            if (z > 48) far += double(i), ++last;
        }
        ASSERT_GT(first, 0u);
        ASSERT_GT(last, 0u);
        EXPECT_LT(near / double(first), far / double(last)) << "order " << int(order);
    }
}

TEST_F(PageOrderTest, BreadthFirstGoesLevelByLevel) {
    store(roughBox());
    look({16, 16, -60}, {16, 16, 16});
    begin();
    request_.order = PageOrder::kBreadthFirst;
    int level = 99;
    for (const PlannedPage& page : plan().pages) {
        const int at = channel_->levelOf({page.page.address.block, page.page.address.node});
        EXPECT_LE(at, level);
        level = at;
    }
    EXPECT_EQ(level, 0);
}

TEST_F(PageOrderTest, KeepsToItsBudgets) {
    store(roughBox());
    look({16, 16, -60}, {16, 16, 16});
    begin();
    const PagePlan everything = plan();
    EXPECT_FALSE(everything.over_budget);
    for (std::uint64_t most : {0ull, 100ull, 5000ull, 50000ull}) {
        request_.max_bytes = most;
        const PagePlan some = plan();
        EXPECT_LE(some.bytes, most);
        EXPECT_TRUE(some.over_budget);
        std::uint64_t sum = 0;
        for (const PlannedPage& page : some.pages) sum += page.bytes;
        EXPECT_EQ(sum, some.bytes);
    }
    request_.max_bytes = UINT64_MAX;
    request_.batch_bytes = 5000;
    const PagePlan batch = plan();
    EXPECT_GE(batch.bytes, 5000u);
    EXPECT_LT(batch.bytes - batch.pages.back().bytes, 5000u) << "ends with the page that reaches it";
    ASSERT_LT(batch.pages.size(), everything.pages.size());
    for (std::size_t i = 0; i < batch.pages.size(); ++i)
        EXPECT_EQ(batch.pages[i].page, everything.pages[i].page) << "a batch is the beginning of the whole";
}

TEST_F(PageOrderTest, IsTheSameEachTime) {
    store(roughBox());
    look({40, 30, -50}, {16, 16, 16});
    begin();
    for (PageOrder order : {PageOrder::kErrorPerByte, PageOrder::kProjectedSize, PageOrder::kBreadthFirst}) {
        request_.order = order;
        const PagePlan a = plan(), b = plan();
        ASSERT_EQ(a.pages.size(), b.pages.size());
        for (std::size_t i = 0; i < a.pages.size(); ++i) {
            EXPECT_EQ(a.pages[i].page, b.pages[i].page);
            EXPECT_EQ(a.pages[i].worth, b.pages[i].worth);
        }
    }
}

TEST_F(PageOrderTest, DoesNotAskForWhatCannotBeHad) {
    store(roughBox());
    look({16, 16, -60}, {16, 16, 16});
    begin();
    const WantedPage gone = plan().pages[0].page;
    request_.failed = [&](const WantedPage& page) { return page == gone; };
    const PagePlan others = plan();
    EXPECT_FALSE(others.pages.empty());
    for (const PlannedPage& page : others.pages) EXPECT_FALSE(page.page == gone);
}

TEST_F(PageOrderTest, FinestResidentPageIsDrawnWhateverIsBetween) {
    store(roughBox());
    look({16, 16, -60}, {16, 16, 16});
    begin();
    // A brick of level 0 whose parents are not there.
    PageAddress page;
    for (const PlannedPage& planned : plan().pages)
        if (channel_->levelOf({planned.page.address.block, planned.page.address.node}) == 0)
            page = planned.page.address;
    page.draft = false;
    resident_.insert(page);
    const ResidentTree tree(*channel_, [&](const PageAddress& p) { return resident_.contains(p); });
    const glm::dvec3 middle = middleOf(page), eye{16, 16, -60};
    const IndexRay ray({eye, glm::normalize(middle - eye)}, channel_->transform());
    bool brick = false, root = false;
    double t = 0;
    walkDrawn(*channel_, tree, ray, ray.clip(channel_->clipLow(), channel_->clipHigh(), {0, 1000}),
              [&](const DrawnPiece& piece) {
                  if (t > 0) EXPECT_EQ(piece.span.begin, t) << "pieces tile the ray";
                  t = piece.span.end;
                  if (piece.status != WalkStatus::kNode) return;
                  brick |= piece.node.ref == NodeRef{page.block, page.node} &&
                           piece.residency == Residency::kWhole;
                  root |= piece.node.ref == NodeRef{0, 0};
              });
    EXPECT_TRUE(brick);
    EXPECT_TRUE(root);
}

}  // namespace
}  // namespace brickyard
