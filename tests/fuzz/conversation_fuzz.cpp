// The input as one client's side of a conversation, step by step: whatever it says, what it is sent keeps to
// its credit, its newest wish, its token's scope and the batch, and is what the dataset holds.
//   u8 configuration, then steps: u8 action | u16 little-endian length | so many bytes
#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <optional>
#include <unordered_map>

#include "core/stream_frame.h"
#include "server/conversation.h"
#include "stream_messages.h"
#include "tiny_dataset.h"

using namespace brickyard;

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t max_size);

namespace {

constexpr std::size_t kStepHead = 3;
// Nodes of both channels of a dataset, and their blocks: the most that a view can bring of each of its
// channels.
constexpr std::size_t kMaxViewed = 400;

void require(bool holds) {
    if (!holds) std::abort();
}

struct World {
    TinyDataset tiny{"tiny", {.payload_bytes = 96}};
    TinyDataset other{"other", {.payload_bytes = 64}};  // another size, so that a page tells whose it is
    std::unique_ptr<Catalog> catalog;
    BatchPool pool{2 * kBatchBytes};
    std::unordered_map<PageAddress, std::vector<std::byte>, PageAddressHash> payloads[2];
    std::shared_ptr<const AccessTokens> tokens;

    World() {
        // A cache that holds no block for long, so that pages wait for the disk again and again.
        auto opened = Catalog::open({tiny.folder(), other.folder()}, 2, 1u << 12);
        require(bool(opened));
        catalog = std::move(*opened);
        const TinyDataset* datasets[] = {&tiny, &other};
        for (int d = 0; d < 2; ++d)
            for (const std::uint32_t channel : {0u, 1u})
                for (const PageAddress& brick : datasets[d]->bricks(channel))
                    payloads[d][brick] = datasets[d]->payload(brick);
        const auto file = tiny.folder().parent_path() / "tokens";
        std::FILE* out = std::fopen(file.c_str(), "w");
        require(out != nullptr && std::fputs("all\nnarrow tiny\n", out) >= 0 && std::fclose(out) == 0);
        auto read = AccessTokens::read(file);
        require(bool(read));
        tokens = std::make_shared<const AccessTokens>(std::move(*read));
    }
};

World& world() {
    static World only;
    return only;
}

// What one client is told, held against what it said.
class Witness {
public:
    explicit Witness(std::uint8_t configuration)
        : budget_((configuration & 4) != 0 ? 5 * sizeof(WishedPage) : 1u << 30),
          tokens_((configuration & 1) != 0 ? world().tokens : nullptr),
          tokens_change_((configuration & 2) != 0),
          talk_({world().catalog.get(), &budget_, nullptr, [this] { return tokens_; }}) {}

    ~Witness() {
        // Whatever the client did, an end comes.
        for (bool more = true; more;) more = fill(ReadMode::kMayBlock, kBatchBytes, 1'000'000);
        require(budget_.usedBytes() <= budget_.limitBytes());
    }

    void receive(std::span<const std::byte> message) {
        if (talk_.over() || talk_.backlogged()) return;
        const auto frame = parseStreamFrame(message, {kMaxClientMessageBytes, 0});
        const std::uint64_t wishes = talk_.wishCount();
        talk_.receive(message);
        owed_ += 1;
        if (talk_.wishCount() != wishes) {
            require(frame && frame->header.has_wish());
            accept(frame->header.wish());
        }
        if (frame && frame->header.has_hello() && !talk_.over()) token_ = frame->header.hello().token();
    }

    void tellNews() {
        if (talk_.over()) return;
        if (tokens_change_) tokens_ = tokens_ ? nullptr : world().tokens;
        talk_.tellNews();
        owed_ += 4;
    }

    // Whether there may be more.
    bool fill(ReadMode mode, std::size_t room, std::size_t max_messages) {
        OutBatch batch(world().pool.take());
        require(bool(batch));
        // What is in a batch already leaves less room.
        std::size_t begin = 0;
        if (room < kBatchBytes) {
            constexpr std::byte kHead[1] = {};
            batch.add(kHead, kBatchBytes - room - 11, /*is_page=*/false);
            begin = batch.size();
        }
        const std::size_t already = batch.messageCount();
        const auto filled =
            talk_.fill(batch, mode, [&] { return batch.messageCount() >= already + max_messages; });
        require(batch.size() <= kBatchBytes);
        require(filled != Conversation::Filled::kWaits || mode == ReadMode::kCachedOnly);
        if (filled == Conversation::Filled::kNothing) require(!talk_.hasMore());
        read({batch.data() + begin, batch.data() + batch.size()});
        require(sent_messages_ <= owed_);
        // A batch of its own holds everything that this world can send.
        if (filled == Conversation::Filled::kFull && max_messages > 0 && batch.messageCount() == already)
            require(room < kBatchBytes && talk_.neededBytes() <= kBatchBytes);
        return filled == Conversation::Filled::kFull;
    }

private:
    void accept(const Wish& wish) {
        require(!epoch_ || wish.epoch() > *epoch_);
        epoch_ = wish.epoch();
        credit_ = wish.credit_bytes();
        sent_bytes_ = 0;
        done_ = false;
        owed_ += std::size_t(wish.pages_size()) + std::size_t(wish.blocks_size()) + 1;
        if (wish.has_camera())
            owed_ += kMaxViewed *
                     std::size_t(1 + wish.camera().channels_size() + wish.camera().channel_names_size());
    }

    void read(std::span<const std::byte> bytes) {
        while (!bytes.empty()) {
            require(bytes[0] == std::byte{0x82});
            std::size_t length = std::to_integer<std::size_t>(bytes[1]);
            std::size_t at = 2;
            if (length >= 126) {
                const std::size_t digits = length == 126 ? 2 : 8;
                length = 0;
                for (std::size_t i = 0; i < digits; ++i)
                    length = length << 8 | std::to_integer<std::size_t>(bytes[at++]);
            }
            require(at + length <= bytes.size());
            const auto message = parseStreamFrame(bytes.subspan(at, length), {kMaxServerHeaderBytes, 4096});
            require(bool(message));
            ++sent_messages_;
            check(*message);
            bytes = bytes.subspan(at + length);
        }
    }

    void check(const StreamFrame& message) {
        const StreamHeader& header = message.header;
        require(!last_);
        if (header.has_page()) {
            const PageRef& ref = header.page().ref();
            checkPayload(header.page().epoch(), message.payload);
            const PageAddress address{ref.channel(), ref.block(), ref.node()};
            const int whose = message.payload.size() == 64 ? 1 : 0;
            const auto stored = world().payloads[whose].find(address);
            require(!ref.draft() && stored != world().payloads[whose].end());
            require(std::ranges::equal(stored->second, message.payload));
            // Without tokens everybody may see everything; with them again, only as far as the token goes.
            if (tokens_ && token_ == "narrow") require(whose == 0);
        } else if (header.has_block_page()) {
            checkPayload(header.block_page().epoch(), message.payload);
        } else if (header.has_wish_done()) {
            require(header.wish_done().epoch() == epoch_ && !done_);
            require(header.wish_done().sent_bytes() == sent_bytes_);
            done_ = true;
        } else if (header.has_failed()) {
            const Failed& failed = header.failed();
            require(failed.message().find('\n') == std::string::npos);
            if (failed.has_page() || failed.has_block()) require(failed.epoch() == epoch_ && !done_);
            last_ = failed.reason() == Failed::REASON_PROTOCOL || failed.reason() == Failed::REASON_VERSION ||
                    failed.reason() == Failed::REASON_TOKEN;
            require(!last_ || talk_.over());
        } else {
            require(header.has_welcome() || header.has_frame_opened() || header.has_pong() ||
                    header.has_dataset_changed() || header.has_catalog_changed());
            require(message.payload.empty());
        }
    }

    void checkPayload(std::uint64_t epoch, std::span<const std::byte> payload) {
        require(epoch_ && epoch == *epoch_ && !done_);
        sent_bytes_ += payload.size();
        require(sent_bytes_ <= credit_);
    }

    ByteBudget budget_;
    std::shared_ptr<const AccessTokens> tokens_;
    const bool tokens_change_;
    Conversation talk_;
    std::string token_;
    std::optional<std::uint64_t> epoch_;
    std::uint64_t credit_ = 0, sent_bytes_ = 0;  // of the newest wish
    bool done_ = false;
    bool last_ = false;  // nothing may follow
    std::size_t owed_ = 0, sent_messages_ = 0;
};

void appendStep(std::string& steps, std::uint8_t action, const std::string& bytes) {
    steps += char(action);
    steps += char(bytes.size() & 0xff);
    steps += char(bytes.size() >> 8 & 0xff);
    steps += bytes;
}

}  // namespace

// Puts a sound message between two steps of the input, or at first a whole sound beginning.
extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t max_size,
                                               unsigned seed) {
    Dice dice(seed);
    if (dice.once(3)) return LLVMFuzzerMutate(data, size, max_size);
    std::string added;
    if (size < 1 || dice.once(32)) {
        size = 0;
        added += char(dice.below(8));
        StreamHeader header;
        header.mutable_hello()->set_protocol_major(1);
        header.mutable_hello()->set_protocol_minor(1);
        header.mutable_hello()->set_token(dice.once(2) ? "all" : "narrow");
        appendStep(added, 1, header.SerializeAsString());
        header.mutable_open()->set_dataset("tiny");
        appendStep(added, 1, header.SerializeAsString());
    }
    std::size_t at = std::min<std::size_t>(size, 1);
    while (at + kStepHead <= size && !dice.once(4))
        at = std::min(size, at + kStepHead + (data[at + 1] | std::size_t(data[at + 2]) << 8));
    appendStep(added, std::uint8_t((dice.next() & 0xfc) | (dice.once(8) ? 2 : 1)),
               randomMessage(dice).SerializeAsString());
    if (size + added.size() > max_size) return LLVMFuzzerMutate(data, size, max_size);
    std::memmove(data + at + added.size(), data + at, size - at);
    std::memcpy(data + at, added.data(), added.size());
    return size + added.size();
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;
    Witness witness(data[0]);
    auto rest = std::as_bytes(std::span(data, size)).subspan(1);
    while (rest.size() >= kStepHead) {
        const auto action = std::to_integer<unsigned>(rest[0]);
        const std::size_t length =
            std::min(rest.size() - kStepHead,
                     std::to_integer<std::size_t>(rest[1]) | std::to_integer<std::size_t>(rest[2]) << 8);
        const auto bytes = rest.subspan(kStepHead, length);
        rest = rest.subspan(kStepHead + length);
        std::vector<std::byte> message;
        switch (action & 3) {
            case 0: witness.receive(bytes); break;
            case 1:
                for (int shift = 0; shift < 32; shift += 8)
                    message.push_back(std::byte(bytes.size() >> shift & 0xff));
                message.insert(message.end(), bytes.begin(), bytes.end());
                witness.receive(message);
                break;
            case 2: witness.tellNews(); break;
            default: break;
        }
        constexpr std::size_t kRooms[] = {kBatchBytes, 64, 300, 2000};
        witness.fill((action & 4) != 0 ? ReadMode::kCachedOnly : ReadMode::kMayBlock, kRooms[action >> 3 & 3],
                     (action >> 5) == 7 ? 1'000'000 : action >> 5);
    }
    return 0;
}
