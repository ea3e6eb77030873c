#include "core/subtree_store.h"

#include <bit>
#include <cstring>

namespace brickyard {
namespace {

// What follows a record in the store.
struct NodeTail {
    NodeRecord record;
    std::uint8_t valid_mask = 0;
    std::uint8_t has_grid = 0;
    std::uint8_t constants = 0;
};

template <class T>
void putValue(const T& value, std::vector<std::byte>& out) {
    static_assert(std::is_trivially_copyable_v<T>);
    const auto* const bytes = reinterpret_cast<const std::byte*>(&value);
    out.insert(out.end(), bytes, bytes + sizeof value);
}

void putNode(const TreeNode& node, std::vector<std::byte>& out) {
    NodeTail tail;
    tail.record = node.record;
    tail.valid_mask = node.valid_mask;
    tail.has_grid = node.grid != nullptr;
    tail.constants = std::uint8_t(node.constant.size());
    putValue(tail, out);
    if (node.grid) putValue(*node.grid, out);
    for (ValueBits bits : node.constant) putValue(bits, out);
    for (const auto& child : node.children) putNode(*child, out);
}

// Reads what putNode wrote: our own bytes, so nothing is checked.
class Reader {
public:
    explicit Reader(std::span<const std::byte> bytes) : next_(bytes.data()) {}
    void node(TreeNode& out) {
        const auto tail = value<NodeTail>();
        out.record = tail.record;
        out.valid_mask = tail.valid_mask;
        if (tail.has_grid) out.grid = std::make_unique<ErrorGrid>(value<ErrorGrid>());
        out.constant.clear();
        for (int c = 0; c < tail.constants; ++c) out.constant.push_back(value<ValueBits>());
        out.children.clear();
        for (int child = std::popcount(tail.valid_mask); child > 0; --child)
            node(*out.children.emplace_back(std::make_unique<TreeNode>()));
    }

private:
    template <class T>
    T value() {
        T out;
        std::memcpy(&out, next_, sizeof out);
        next_ += sizeof out;
        return out;
    }
    const std::byte* next_;
};

std::uint32_t countBelow(const TreeNode& node) {
    std::uint32_t nodes = 0;
    for (const auto& child : node.children) nodes += 1 + countBelow(*child);
    return nodes;
}

}  // namespace

Result<std::unique_ptr<TreeNode>> SubtreeStore::put(std::unique_ptr<TreeNode> root) {
    if (root->children.empty()) return root;
    std::vector<std::byte> bytes(sizeof(std::uint64_t));
    putNode(*root, bytes);
    const std::uint64_t size = bytes.size() - sizeof size;
    std::memcpy(bytes.data(), &size, sizeof size);
    const auto at = scratch_->append(bytes);
    if (!at) return tl::unexpected(at.error());
    auto stub = std::make_unique<TreeNode>();
    stub->valid_mask = root->valid_mask;
    stub->unloaded = countBelow(*root);
    stub->handle = *at;
    return stub;
}

Result<void> SubtreeStore::load(TreeNode& stub) const {
    std::uint64_t size = 0;
    if (auto read = scratch_->read(stub.handle, std::as_writable_bytes(std::span(&size, 1))); !read)
        return read;
    std::vector<std::byte> bytes(size);
    if (auto read = scratch_->read(stub.handle + sizeof size, bytes); !read) return read;
    Reader(bytes).node(stub);
    return {};
}

}  // namespace brickyard
