#include "core/tree_block.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <random>
#include <string>

#include "core/tree_block_encoder.h"
#include "core/tree_block_format.h"
#include "core/zstd_frame.h"

namespace brickyard {
namespace {

using testing::HasSubstr;
using Roots = std::vector<std::unique_ptr<TreeNode>>;

constexpr std::uint64_t kFileBytes = std::uint64_t(1) << 40;

// A tree with every kind of node; the same for the same seed.
class RandomTree {
public:
    RandomTree(unsigned seed, int components, std::size_t most_nodes, double child_chance)
        : random_(seed), components_(components), left_(most_nodes), child_chance_(child_chance) {}

    Roots roots(std::size_t count, int depth) {
        Roots made;
        for (std::size_t i = 0; i < count; ++i) made.push_back(node(depth));
        return made;
    }
    std::size_t made() const { return made_; }

private:
    float fraction() { return float(random_() % 4096) / 4096; }

    std::unique_ptr<TreeNode> node(int depth) {
        auto made = std::make_unique<TreeNode>();
        ++made_;
        NodeRecord& r = made->record;
        if (random_() % 4 != 0) {
            r.payload_bytes = 1 + std::uint32_t(random_() % 20000);
            r.payload_offset = random_() % 3 == 0 ? random_() % (kFileBytes / 2) : payload_end_;
            payload_end_ = r.payload_offset + r.payload_bytes;
            r.payload_checksum = random_();
            if (depth == 1 && random_() % 2 == 0) {
                r.draft_bytes = std::uint32_t(random_() % r.payload_bytes);
                if (r.hasDraft()) {
                    r.draft_checksum = random_();
                    r.draft_bound = fraction();
                    r.draft_rms = r.draft_bound * fraction();
                }
            }
        } else {
            for (int c = 0; c < components_; ++c)
                made->constant.push_back(random_() % 5 * 0x123456789abcdefull);
            r.active = random_() % 2 == 0;
        }
        r.value_min = fraction() - 1;
        r.value_max = r.value_min + fraction();
        r.bound = fraction();
        r.rms = r.bound * fraction();
        for (std::size_t axis = 0; axis < 3; ++axis) {
            r.box_begin[axis] = std::uint8_t(random_() % 9);
            r.box_end[axis] = std::uint8_t(r.box_begin[axis] + random_() % 8);
        }
        if (random_() % 3 == 0) {
            made->grid = std::make_unique<ErrorGrid>();
            for (auto& code : made->grid->bound) code = std::uint8_t(random_());
            for (auto& code : made->grid->rms) code = std::uint8_t(random_());
        }
        for (unsigned octant = 0; depth > 1 && octant < 8; ++octant) {
            if (left_ == 0 || fraction() >= child_chance_) continue;
            --left_;
            made->valid_mask = std::uint8_t(made->valid_mask | 1u << octant);
            made->children.push_back(node(depth - 1));
        }
        return made;
    }

    std::mt19937_64 random_;
    int components_;
    std::size_t left_;
    std::size_t made_ = 0;
    double child_chance_;
    std::uint64_t payload_end_ = 4096;
};

// A tree as the frame file has it, and its decoded blocks.
struct StoredTree {
    std::vector<std::vector<std::byte>> stored;
    std::vector<std::uint32_t> raw_bytes;
    std::vector<TreeBlock> blocks;

    StoredTree(const Roots& roots, int components) {
        stored = encodeTree(roots, components, raw_bytes);
        for (std::uint32_t b = 0; b < stored.size(); ++b) {
            auto block = decodeStoredBlock(stored[b], raw_bytes[b], b, std::uint32_t(stored.size()),
                                           kFileBytes, components);
            EXPECT_TRUE(block) << "block " << b << ": " << block.error().message;
            if (!block) break;
            blocks.push_back(std::move(*block));
        }
    }
};

void expectEqual(const TreeNode& expected, const TreeBlock& block, std::uint32_t at) {
    const NodeRecord &e = expected.record, &r = block.record(at);
    ASSERT_EQ(r.payload_bytes, e.payload_bytes);
    ASSERT_EQ(r.payload_offset, e.payload_offset);
    ASSERT_EQ(r.payload_checksum, e.payload_checksum);
    ASSERT_EQ(r.value_min, e.value_min);
    ASSERT_EQ(r.value_max, e.value_max);
    ASSERT_EQ(r.bound, e.bound);
    ASSERT_EQ(r.rms, e.rms);
    ASSERT_EQ(r.draft_bytes, e.draft_bytes);
    ASSERT_EQ(r.draft_checksum, e.draft_checksum);
    ASSERT_EQ(r.draft_bound, e.draft_bound);
    ASSERT_EQ(r.draft_rms, e.draft_rms);
    ASSERT_EQ(r.box_begin, e.box_begin);
    ASSERT_EQ(r.box_end, e.box_end);
    ASSERT_EQ(r.active, e.active);
    if (!e.hasBrick()) {
        const auto constant = block.constant(at);
        ASSERT_TRUE(
            std::equal(constant.begin(), constant.end(), expected.constant.begin(), expected.constant.end()));
    }
    ASSERT_EQ(block.errorGrid(at) != nullptr, expected.grid != nullptr);
    if (expected.grid) {
        ASSERT_EQ(block.errorGrid(at)->bound, expected.grid->bound);
        ASSERT_EQ(block.errorGrid(at)->rms, expected.grid->rms);
    }
    ASSERT_EQ(block.validMask(at), expected.valid_mask);
    ASSERT_EQ(block.isLeaf(at), expected.children.empty());
}

// Walks the tree and its blocks together; `visited` counts the nodes of each block.
void expectReachable(const TreeNode& expected, const StoredTree& tree, std::uint32_t block, std::uint32_t at,
                     std::vector<std::uint32_t>& visited) {
    ++visited[block];
    ASSERT_LT(at, tree.blocks[block].nodeCount());
    ASSERT_NO_FATAL_FAILURE(expectEqual(expected, tree.blocks[block], at));
    if (expected.children.empty()) return;

    const ChildrenRef children = tree.blocks[block].children(at);
    if (children.block != block) {
        ASSERT_GT(children.block, block) << "a parent's block comes first";
        ASSERT_LT(children.block, tree.blocks.size());
        ASSERT_EQ(children.first, 0u);
        ASSERT_EQ(tree.blocks[children.block].headNodes(), expected.children.size());
    }
    std::uint32_t child = 0;
    for (unsigned octant = 0; octant < 8; ++octant) {
        if ((expected.valid_mask >> octant & 1) == 0) continue;
        const TreeNode& node = *expected.children[child];
        ASSERT_EQ((tree.blocks[block].leafMask(at) >> octant & 1) != 0, node.children.empty());
        ASSERT_NO_FATAL_FAILURE(expectReachable(node, tree, children.block, children.first + child, visited));
        ++child;
    }
}

void expectSameTree(const Roots& roots, int components, std::size_t nodes) {
    const StoredTree tree(roots, components);
    ASSERT_EQ(tree.blocks.size(), tree.stored.size());
    ASSERT_EQ(tree.blocks[0].headNodes(), roots.size());
    std::vector<std::uint32_t> visited(tree.blocks.size(), 0);
    for (std::uint32_t r = 0; r < roots.size(); ++r)
        ASSERT_NO_FATAL_FAILURE(expectReachable(*roots[r], tree, 0, r, visited));
    std::size_t sum = 0;
    for (std::size_t b = 0; b < visited.size(); ++b) {
        EXPECT_EQ(visited[b], tree.blocks[b].nodeCount()) << "block " << b << " has nodes that no walk meets";
        EXPECT_LE(visited[b], kMaxBlockNodes);
        if (b > 0) {
            EXPECT_GE(visited[b], kBlockTargetNodes) << "block " << b;
        }
        EXPECT_LE(tree.raw_bytes[b], kMaxBlockRawBytes);
        EXPECT_GT(tree.blocks[b].memoryBytes(), visited[b] * sizeof(NodeRecord));
        sum += visited[b];
    }
    EXPECT_EQ(sum, nodes);
}

TEST(TreeBlockTest, EveryNodeIsReachedWithWhatItHad) {
    for (unsigned seed = 1; seed <= 24; ++seed) {
        const int depth = 1 + int(seed % 12), components = seed % 2 == 0 ? 3 : 1;
        RandomTree random(seed, components, seed % 8 == 0 ? 200000 : 5000, seed % 3 == 0 ? 0.35 : 0.9);
        const Roots roots = random.roots(1 + seed % 8, depth);
        ASSERT_NO_FATAL_FAILURE(expectSameTree(roots, components, random.made())) << "seed " << seed;
    }
}

TEST(TreeBlockTest, ALongChainIsOneBlock) {
    RandomTree random(1, 1, 0, 0);
    Roots roots = random.roots(1, 1);
    std::size_t nodes = 1;
    for (TreeNode* at = roots[0].get(); nodes < 32; ++nodes, at = at->children[0].get()) {
        at->valid_mask = 0x80;
        NodeRecord& r = at->record;  // it was a leaf
        r.draft_bytes = 0, r.draft_checksum = 0, r.draft_bound = 0, r.draft_rms = 0;
        at->children = random.roots(1, 1);
    }
    ASSERT_NO_FATAL_FAILURE(expectSameTree(roots, 1, nodes));
}

TEST(TreeBlockTest, AFullTreeIsCutIntoBlocksOfAFewThousandNodes) {
    RandomTree random(2, 1, 100000, 1.0);
    const Roots roots = random.roots(1, 6);
    const StoredTree tree(roots, 1);
    EXPECT_GT(tree.blocks.size(), 8u);
    EXPECT_LT(tree.blocks.size(), 100000 / kBlockTargetNodes + 1);
}

TEST(TreeBlockTest, NoRootsGiveNoBlocks) {
    std::vector<std::uint32_t> raw_bytes{7};
    EXPECT_TRUE(encodeTree({}, 1, raw_bytes).empty());
    EXPECT_TRUE(raw_bytes.empty());
}

TEST(ErrorCodeTest, CodesRoundUpAndNotFurtherThanAStep) {
    std::mt19937_64 random(1);
    for (const float scale : {1.0f, 0.37f, 3e38f, 1e-30f}) {
        EXPECT_EQ(errorFromCode(0, scale), 0);
        EXPECT_EQ(errorFromCode(255, scale), scale);
        EXPECT_EQ(errorToCode(0, scale), 0);
        EXPECT_EQ(errorToCode(scale, scale), 255);
        for (int i = 0; i < 20000; ++i) {
            const double error = double(scale) * std::exp2(-double(random() % 40000) / 1000);
            const std::uint8_t code = errorToCode(error, scale);
            ASSERT_GE(double(errorFromCode(code, scale)), error);
            ASSERT_LT(double(errorFromCode(std::uint8_t(code - 1), scale)), error) << "not the least code";
        }
    }
    for (const float scale : {1e-45f, 1e-42f, 1e-38f})
        for (double error = scale; error > 1e-60; error *= 0.7)
            ASSERT_GE(errorFromCode(errorToCode(error, scale), scale), error);
}

TEST(ErrorCodeTest, AStepIsAnEighthOfAnOctave) {
    for (int code = 1; code <= 255; ++code)
        EXPECT_NEAR(errorFromCode(std::uint8_t(code), 1) / std::exp2((code - 255) / 8.0), 1, 1e-6) << code;
}

// Touches all that accessors can reach within a block, as a reader would.
void useBlock(const TreeBlock& block, std::uint32_t own_index, std::uint32_t block_count) {
    std::vector<std::uint32_t> pending;
    std::size_t met = 0;
    for (std::uint32_t head = 0; head < block.headNodes(); ++head) pending.push_back(head);
    std::uint64_t sum = 0;
    while (!pending.empty()) {
        const std::uint32_t node = pending.back();
        pending.pop_back();
        ASSERT_LE(++met, block.nodeCount()) << "a node was met twice";
        const NodeRecord& r = block.record(node);
        ASSERT_TRUE(std::isfinite(r.value_min) && r.value_min <= r.value_max && std::isfinite(r.value_max));
        ASSERT_TRUE(std::isfinite(r.bound) && r.bound >= 0 && std::isfinite(r.rms) && r.rms >= 0);
        ASSERT_TRUE(!r.hasBrick() ||
                    (r.payload_offset <= kFileBytes && r.payload_bytes <= kFileBytes - r.payload_offset));
        ASSERT_TRUE(std::isfinite(r.draft_bound) && r.draft_bound >= 0 && std::isfinite(r.draft_rms) &&
                    r.draft_rms >= 0);
        ASSERT_TRUE(!r.hasDraft() || (r.draft_bytes < r.payload_bytes && block.isLeaf(node)));
        if (!r.hasBrick())
            for (const ValueBits bits : block.constant(node)) sum += bits;
        if (const ErrorGrid* grid = block.errorGrid(node)) sum += grid->bound[63] + grid->rms[63];
        if (block.isLeaf(node)) continue;
        const ChildrenRef children = block.children(node);
        if (children.block != own_index) {
            ASSERT_LT(children.block, block_count);
            ASSERT_GT(children.block, own_index);
            continue;
        }
        for (int i = 0; i < std::popcount(block.validMask(node)); ++i)
            pending.push_back(children.first + std::uint32_t(i));
    }
    EXPECT_EQ(met, block.nodeCount());
    volatile std::uint64_t keep = sum;
    (void)keep;
}

// One small block that refers to two others: its raw and its stored bytes.
class DamagedBlockTest : public testing::Test {
protected:
    static constexpr std::uint32_t kBlocks = 3;

    void SetUp() override {
        RandomTree random(5, 3, 40, 0.7);
        const Roots roots = random.roots(2, 4);
        std::vector<std::uint32_t> raw_bytes;
        const auto blocks = encodeTree(roots, 3, raw_bytes);
        ASSERT_EQ(blocks.size(), 1u);
        stored_ = blocks[0];
        raw_.resize(raw_bytes[0]);
        ASSERT_TRUE(readZstdFrame(stored_, raw_));
        std::memcpy(&header_, raw_.data(), sizeof(header_));
    }

    // Exactly as many bytes as given, so that a read past their end is caught by ASan.
    Result<TreeBlock> decode(std::span<const std::byte> raw) const {
        const std::vector<std::byte> exact(raw.begin(), raw.end());
        return TreeBlock::decode(exact, 0, kBlocks, kFileBytes, 3);
    }
    // Number `i` of a column that begins at `column_begin` bytes behind the header and has `count` numbers.
    template <class T>
    T get(std::size_t column_begin, std::size_t count, std::size_t i) const {
        T value;
        for (std::size_t j = 0; j < sizeof(T); ++j)
            reinterpret_cast<std::byte*>(&value)[j] = raw_[sizeof(header_) + column_begin + j * count + i];
        return value;
    }
    template <class T>
    std::vector<std::byte> with(std::size_t column_begin, std::size_t count, std::size_t i, T value) const {
        auto changed = raw_;
        for (std::size_t j = 0; j < sizeof(T); ++j)
            changed[sizeof(header_) + column_begin + j * count + i] =
                reinterpret_cast<const std::byte*>(&value)[j];
        return changed;
    }
    std::vector<std::byte> withDescriptor(std::size_t node, std::uint32_t descriptor) const {
        return with(0, header_.nodes, node, descriptor);
    }
    std::uint32_t descriptor(std::size_t node) const { return get<std::uint32_t>(0, header_.nodes, node); }
    void expectRefused(const std::vector<std::byte>& raw, const std::string& message) const {
        const auto block = decode(raw);
        ASSERT_FALSE(block) << "accepted; expected: " << message;
        EXPECT_EQ(block.error().code, ErrorCode::kCorrupt);
        EXPECT_THAT(block.error().message, HasSubstr(message));
    }

    std::vector<std::byte> stored_, raw_;
    TreeBlockHeader header_;
};

TEST_F(DamagedBlockTest, RefusesEveryTruncation) {
    for (std::size_t size = 0; size < raw_.size(); ++size)
        ASSERT_FALSE(decode(std::span(raw_).first(size))) << size << " of " << raw_.size() << " raw bytes";
    for (std::size_t size = 0; size < stored_.size(); ++size) {
        const std::vector<std::byte> prefix(stored_.begin(), stored_.begin() + std::ptrdiff_t(size));
        ASSERT_FALSE(decodeStoredBlock(prefix, std::uint32_t(raw_.size()), 0, kBlocks, kFileBytes, 3))
            << size << " of " << stored_.size() << " stored bytes";
    }
}

TEST_F(DamagedBlockTest, SurvivesEveryFlippedByte) {
    std::size_t accepted = 0;
    for (const unsigned flip : {0x01u, 0x20u, 0x80u, 0xffu}) {
        for (std::size_t at = 0; at < raw_.size(); ++at) {
            auto damaged = raw_;
            damaged[at] ^= std::byte(std::uint8_t(flip));
            if (const auto block = decode(damaged)) {
                ASSERT_NO_FATAL_FAILURE(useBlock(*block, 0, kBlocks)) << "raw byte " << at;
                ++accepted;
            }
        }
        for (std::size_t at = 0; at < stored_.size(); ++at) {
            auto damaged = stored_;
            damaged[at] ^= std::byte(std::uint8_t(flip));
            if (const auto block =
                    decodeStoredBlock(damaged, std::uint32_t(raw_.size()), 0, kBlocks, kFileBytes, 3)) {
                ASSERT_NO_FATAL_FAILURE(useBlock(*block, 0, kBlocks)) << "stored byte " << at;
            }
        }
    }
    EXPECT_GT(accepted, 0u) << "values and checksums of payloads may be anything";
}

TEST_F(DamagedBlockTest, RefusesAnotherVersionByItsNumber) {
    auto changed = raw_;
    changed[4] = std::byte{2};
    expectRefused(changed, "version 2");
}

TEST_F(DamagedBlockTest, RefusesAnotherNumberOfComponents) {
    EXPECT_FALSE(TreeBlock::decode(raw_, 0, kBlocks, kFileBytes, 1));
}

TEST_F(DamagedBlockTest, RefusesPayloadsBeyondTheFile) {
    EXPECT_FALSE(TreeBlock::decode(raw_, 0, kBlocks, /*file_bytes=*/5000, 3));
}

TEST_F(DamagedBlockTest, RefusesASizeAboveTheLimit) {
    EXPECT_FALSE(decodeStoredBlock(stored_, kMaxBlockRawBytes + 1, 0, kBlocks, kFileBytes, 3));
    EXPECT_FALSE(decodeStoredBlock(stored_, std::uint32_t(raw_.size()) + 1, 0, kBlocks, kFileBytes, 3));
}

TEST_F(DamagedBlockTest, RefusesCountsThatDoNotFitTheLength) {
    for (const std::size_t field : {8u, 12u, 16u, 20u, 24u})
        for (const std::uint32_t count : {0u, 1u << 20, 0xffffffffu}) {
            auto changed = raw_;
            if (std::memcmp(&changed[field], &count, 4) == 0) continue;
            std::memcpy(&changed[field], &count, 4);
            EXPECT_FALSE(decode(changed)) << "field at " << field << " set to " << count;
        }
}

TEST_F(DamagedBlockTest, RefusesPointersThatCannotBe) {
    ASSERT_GT(header_.nodes, 10u);
    ASSERT_NE(descriptor(0), 0u);
    std::uint32_t inner = 1;
    while (descriptor(inner) == 0) ++inner;
    const std::uint32_t masks = descriptor(0) & 0xffffu;
    expectRefused(withDescriptor(0, masks), "has its children at 0");
    expectRefused(withDescriptor(0, masks | kMaxChildPointer << kChildPointerShift),
                  "has its children at 32767");
    // The children of another node: they would have two parents, and those of node 0 none.
    const std::uint32_t stolen = inner + (descriptor(inner) >> kChildPointerShift);
    expectRefused(withDescriptor(0, (descriptor(inner) & 0xffffu) | stolen << kChildPointerShift), "parent");
    expectRefused(withDescriptor(0, masks | kFarFlag), "far pointer 0 of 0");
    expectRefused(withDescriptor(0, 0x20000u), "leaf 0 has a child pointer");
    expectRefused(withDescriptor(0, 0), "no parent");
}

// One root, whose children and theirs stand in other blocks or far away; built by hand.
std::vector<std::byte> handMadeBlock(const std::vector<std::uint32_t>& descriptors,
                                     const std::vector<std::uint32_t>& far) {
    TreeBlockHeader header;
    header.nodes = std::uint32_t(descriptors.size());
    header.head_nodes = 1;
    header.far_entries = std::uint32_t(far.size());
    header.constants = 1;
    std::vector<std::byte> raw;
    ByteWriter writer(raw);
    writer.put(header);
    putColumn(descriptors, raw);
    putColumn(far, raw);
    raw.resize(raw.size() + descriptors.size() * (kTreeBlockNodeBytes - 4) + 8);
    return raw;
}

TEST(FarPointerTest, ReachesNodesAndBlocksAndNothingElse) {
    const auto decode = [](const std::vector<std::uint32_t>& descriptors,
                           const std::vector<std::uint32_t>& far) {
        return TreeBlock::decode(handMadeBlock(descriptors, far), /*own_index=*/2, /*block_count=*/5,
                                 kFileBytes, 1);
    };
    const std::uint32_t two_leaves = 0x0303u, one_inner = 0x0100u;

    const auto within = decode({kFarFlag | two_leaves, 0, 0}, {1});
    ASSERT_TRUE(within) << within.error().message;
    EXPECT_EQ(within->children(0).block, 2u);
    EXPECT_EQ(within->children(0).first, 1u);

    const auto beyond = decode({kFarFlag | two_leaves}, {kFarIsBlock | 4});
    ASSERT_TRUE(beyond) << beyond.error().message;
    EXPECT_EQ(beyond->children(0).block, 4u);
    EXPECT_EQ(beyond->children(0).first, 0u);

    EXPECT_FALSE(decode({kFarFlag | two_leaves}, {kFarIsBlock | 2})) << "a block that is its own descendant";
    EXPECT_FALSE(decode({kFarFlag | two_leaves}, {kFarIsBlock | 1})) << "a block before its parent";
    EXPECT_FALSE(decode({kFarFlag | two_leaves}, {kFarIsBlock | 5})) << "a block that is not there";
    EXPECT_FALSE(decode({kFarFlag | two_leaves, 0, 0}, {0})) << "a node that is its own child";
    EXPECT_FALSE(decode({kFarFlag | two_leaves, 0, 0}, {2})) << "children that end behind the block";
    EXPECT_FALSE(decode({kFarFlag | two_leaves, 0, 0}, {0x7fffffffu})) << "children far behind the block";
    EXPECT_FALSE(decode({kFarFlag | two_leaves, 0, 0}, {1, 1})) << "an entry that no node uses";
    // Two nodes whose children are the same block.
    const std::uint32_t two_inner = 0x0300u | 1u << kChildPointerShift;
    EXPECT_FALSE(decode({two_inner, kFarFlag | two_leaves, kFarFlag | 1u << kChildPointerShift | two_leaves},
                        {kFarIsBlock | 3, kFarIsBlock | 3}));
    EXPECT_TRUE(decode({two_inner, kFarFlag | two_leaves, kFarFlag | 1u << kChildPointerShift | two_leaves},
                       {kFarIsBlock | 3, kFarIsBlock | 4}));

    // A chain may be as deep as there are levels, and no deeper.
    std::vector<std::uint32_t> chain(32, one_inner | 1u << kChildPointerShift);
    chain[30] = 0x0101u | 1u << kChildPointerShift;
    chain[31] = 0;
    EXPECT_TRUE(decode(chain, {}));
    chain[30] = one_inner | 1u << kChildPointerShift;
    chain[31] = 0x0101u | 1u << kChildPointerShift;
    chain.push_back(0);
    EXPECT_FALSE(decode(chain, {}));
}

TEST_F(DamagedBlockTest, RefusesNumbersThatCannotBe) {
    // Columns behind descriptors and far pointers: flags, box, payload bytes, steps, checksums, floats,
    // constants.
    const std::size_t n = header_.nodes, flags = 4 * n + 4 * header_.far_entries, box = flags + n,
                      payload = box + 6 * n;
    const std::size_t value_min = payload + 20 * n, value_max = value_min + 4 * n, bound = value_max + 4 * n;
    const std::size_t rms = bound + 4 * n, constant = rms + 4 * n;
    const std::size_t draft = constant + 4 * n, draft_checksum = draft + 4 * n;
    const std::size_t draft_bound = draft_checksum + 8 * n, draft_rms = draft_bound + 4 * n;
    const float nan = std::numeric_limits<float>::quiet_NaN(),
                infinity = std::numeric_limits<float>::infinity();
    std::size_t with_payload = 0, of_one_value = 0;
    while (get<std::uint32_t>(payload, n, with_payload) == 0) ++with_payload;
    while (get<std::uint32_t>(payload, n, of_one_value) != 0) ++of_one_value;

    expectRefused(with(flags, n, 0, std::uint8_t(4)), "flags");
    expectRefused(with(flags, n, 0, std::uint8_t(get<std::uint8_t>(flags, n, 0) ^ kNodeHasGrid)),
                  "error grid");
    expectRefused(with(box + 3 * n, n, 2, std::uint8_t(65)), "box");
    expectRefused(with(box, n, 2, std::uint8_t(64)), "box");
    expectRefused(with(payload, n, with_payload, std::uint32_t(33) << 20), "claims");
    expectRefused(with(payload, n, with_payload, std::uint32_t(0)), "no payload");
    expectRefused(with(value_min, n, 0, nan), "has values");
    expectRefused(with(value_max, n, 0, infinity), "has values");
    expectRefused(with(value_min, n, 0, 100.0f), "has values");
    expectRefused(with(bound, n, 0, -1.0f), "error bound");
    expectRefused(with(bound, n, 0, infinity), "error bound");
    expectRefused(with(rms, n, 0, nan), "error bound");
    expectRefused(with(constant, n, of_one_value, header_.constants), "constant");
    expectRefused(with(constant, n, with_payload, std::uint32_t(1)), "constant");

    std::size_t drafted = 0, plain_leaf = 0;
    while (get<std::uint32_t>(draft, n, drafted) == 0) ++drafted;
    while (descriptor(plain_leaf) != 0 || get<std::uint32_t>(draft, n, plain_leaf) != 0) ++plain_leaf;
    ASSERT_LT(drafted, n);
    ASSERT_LT(plain_leaf, n);
    ASSERT_EQ(descriptor(drafted), 0u);
    ASSERT_NE(descriptor(with_payload), 0u) << "the test wants an inner node with a payload";
    expectRefused(with(draft, n, drafted, get<std::uint32_t>(payload, n, drafted)), "no more");
    expectRefused(with(draft, n, of_one_value, std::uint32_t(1)), "draft");
    expectRefused(with(draft, n, with_payload, std::uint32_t(1)), "is no leaf");
    expectRefused(with(draft, n, drafted, std::uint32_t(0)), "has no draft");
    expectRefused(with(draft_checksum, n, plain_leaf, std::uint64_t(1)), "has no draft");
    expectRefused(with(draft_bound, n, plain_leaf, 1.0f), "has no draft");
    expectRefused(with(draft_bound, n, drafted, -1.0f), "draft with error bound");
    expectRefused(with(draft_bound, n, drafted, infinity), "draft with error bound");
    expectRefused(with(draft_rms, n, drafted, nan), "draft with error bound");
}

// A block written by the first version: it must decode for ever.
TEST(TreeBlockTest, AnOldBlockStillDecodes) {
    const std::string hex =
        "28b52ffd607900ad040072061621a06b58038a1a3ec4e3158805fe959df64057f8e0d6dbe7f477198c297e597bcb14"
        "970e65900e4cb870e2c58d21837f38425515c5b11a410b2285f13179554e98b789a28e8c64babb3be90e3064f6792c"
        "6b8736b32e85151a008000e4ea44ef2ec00280f7d202e23101039fad41009219f4850358008606635c8a1b29ae8104"
        "2da2b90b6636f52274f34ed7d88b1330a004";
    std::vector<std::byte> stored;
    for (std::size_t i = 0; i < hex.size(); i += 2)
        stored.push_back(std::byte(std::stoul(hex.substr(i, 2), nullptr, 16)));
    const auto block = decodeStoredBlock(stored, /*raw_bytes=*/377, 0, 1, 2000, 1);
    ASSERT_TRUE(block) << block.error().message;
    ASSERT_EQ(block->nodeCount(), 3u);
    EXPECT_EQ(block->headNodes(), 1u);

    // A root with a brick and a grid; its child in octant 1 has a brick with a draft, the one in octant 6 is
    // 0.5 everywhere.
    EXPECT_EQ(block->validMask(0), 0x42);
    EXPECT_EQ(block->leafMask(0), 0x42);
    EXPECT_EQ(block->children(0).first, 1u);
    const NodeRecord &root = block->record(0), &brick = block->record(1), &tile = block->record(2);
    EXPECT_EQ(root.payload_offset, 1000u);
    EXPECT_EQ(root.payload_bytes, 50u);
    EXPECT_EQ(root.payload_checksum, 0x0123456789abcdefull);
    EXPECT_EQ(root.value_min, 0.0f);
    EXPECT_EQ(root.value_max, 2.0f);
    EXPECT_EQ(root.bound, 0.25f);
    EXPECT_EQ(root.rms, 0.125f);
    EXPECT_EQ(root.box_begin, (std::array<std::uint8_t, 3>{1, 2, 3}));
    EXPECT_EQ(root.box_end, (std::array<std::uint8_t, 3>{14, 15, 16}));
    ASSERT_NE(block->errorGrid(0), nullptr);
    EXPECT_EQ(block->errorGrid(0)->bound[63], 255);
    EXPECT_EQ(block->errorGrid(0)->rms[0], 200);
    EXPECT_EQ(brick.payload_offset, 100u);
    EXPECT_EQ(brick.payload_bytes, 900u);
    EXPECT_EQ(brick.value_max, 2.0f);
    EXPECT_EQ(brick.draft_bytes, 300u);
    EXPECT_EQ(brick.draft_checksum, 0x0f1e2d3c4b5a6978ull);
    EXPECT_EQ(brick.draft_bound, 0.0625f);
    EXPECT_EQ(brick.draft_rms, 0.03125f);
    EXPECT_FALSE(root.hasDraft());
    EXPECT_EQ(block->errorGrid(1), nullptr);
    EXPECT_FALSE(tile.hasBrick());
    EXPECT_TRUE(tile.active);
    EXPECT_EQ(block->constant(2)[0], 0x3f000000u);
}

}  // namespace
}  // namespace brickyard
