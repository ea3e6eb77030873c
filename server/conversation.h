// One client's side of the stream, without its socket: messages in, messages out. docs/protocol.md, "States".
// One thread at a time; whoever owns the socket calls receive() for each message that came and writes what
// fill() gives, so that a new wish overtakes everything but what is in the socket.
#pragma once

#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/frame_reader.h"
#include "server/catalog.h"
#include "server/metrics.h"
#include "server/offer.h"
#include "server/out_batch.h"
#include "server/wish_queue.h"

namespace brickyard {

// Limits of stream.proto.
inline constexpr int kMaxWishPages = 65536;
inline constexpr int kMaxWishBlocks = 4096;
inline constexpr int kMaxWishChannels = 64;
inline constexpr std::uint32_t kMaxPictureEdge = 65536;
inline constexpr std::size_t kMaxOpenDatasets = 16;
// Frames that a connection keeps as they were; of more, the one that was opened first is looked up again.
inline constexpr std::size_t kMaxKeptFrames = 4;
inline constexpr int kMaxChannelNameBytes = 1024;
inline constexpr std::size_t kMaxClientNameBytes = 256;
inline constexpr std::size_t kMaxDatasetNameBytes = 1024;

// What a conversation needs of its server. The pointers may be nullptr: no limit, nothing counted.
struct ConversationServices {
    const Catalog* catalog = nullptr;  // REQUIRES: not nullptr
    ByteBudget* wish_budget = nullptr;
    Metrics* metrics = nullptr;
    // The tokens that count now.
    std::function<std::shared_ptr<const AccessTokens>()> tokens;
};

class Conversation {
public:
    explicit Conversation(ConversationServices services);

    // A whole binary message. Answers are queued, wishes replace each other. Reads from the disk. REQUIRES:
    // !over().
    void receive(std::span<const std::byte> message);
    // The peer broke the protocol below the messages (too long, text, too slow): tell it, then end.
    void refuse(const std::string& why) { end(Failed::REASON_PROTOCOL, why); }
    // The server cannot go on with this client for now.
    void refuseBusy(const std::string& why) { end(Failed::REASON_BUSY, why); }
    // Something of the catalog changed, or of who may see it: tells the client what it wants to know of it.
    // Reads from the disk.
    void tellNews();

    enum class Filled {
        kNothing,  // nothing is left to be said for now
        kFull,     // there is more
        kWaits,    // only the disk has what comes next, and it must not be waited for
    };
    // Adds what is to be sent to a batch, until it is full, `interrupted` says true, or nothing is left.
    Filled fill(OutBatch& batch, ReadMode mode, const std::function<bool()>& interrupted);
    // After kFull left a batch empty: the room that the next message needs.
    std::size_t neededBytes() const { return needed_bytes_; }
    // Whether fill() has something to do.
    bool hasMore() const { return !answers_.empty() || (!over_ && !wishes_.empty()); }

    // The newest wish that was received; a rise means that the pages of older ones are of no use any more.
    std::uint64_t wishCount() const { return wish_count_; }

    // A dataset was opened: what follows may take as long as it likes.
    bool established() const { return !datasets_.empty(); }
    // So many answers wait that no more should be read until some are written.
    bool backlogged() const { return answers_.size() >= kMaxAnswers || answer_bytes_ >= kMaxAnswerBytes; }
    // Nothing more is received; when fill() gives nothing, close.
    bool over() const { return over_; }
    // Program and version that the client gave, for the log; printable.
    const std::string& clientName() const { return client_name_; }

private:
    static constexpr std::size_t kMaxAnswers = 16, kMaxAnswerBytes = 1u << 20;

    struct OpenDataset {
        std::string name;
        std::shared_ptr<const Dataset> told;  // as the client knows it; nullptr: that it is gone
        // The frames that this connection has opened, as they were then.
        std::vector<ServedFrame> frames;
    };

    void onHello(const Hello& hello);
    void onOpen(const Open& open);
    void onOpenFrame(const OpenFrame& open_frame);
    void onWish(const Wish& wish);
    OpenDataset* datasetOf(std::uint32_t id, const char* message);
    // As this connection has opened it, or else as it is now.
    Result<ServedFrame> frameOf(OpenDataset& dataset, std::uint32_t number, bool first) const;
    void keep(OpenDataset& dataset, const ServedFrame& frame);
    // Whether the token still counts; ends the conversation where it does not.
    bool checkToken(const std::string& token, const char* why_not);
    void answer(const StreamHeader& header);
    // Failed, and the connection goes on.
    void fail(const Failed& failed);
    // Failed, and it is the last message.
    void end(Failed::Reason reason, const std::string& why);

    const ConversationServices services_;
    bool greeted_ = false;
    bool over_ = false;
    bool open_failed_ = false;  // the last Open
    std::uint32_t client_minor_ = 0;
    std::string client_name_, token_;
    std::shared_ptr<const AccessTokens> checked_;  // those that the token was found in
    std::optional<Offer> offer_;                   // once greeted
    std::vector<std::string> told_names_;
    std::vector<OpenDataset> datasets_;   // the dataset with id i + 1
    std::optional<std::uint64_t> epoch_;  // of the newest wish
    std::uint64_t wish_count_ = 0;
    std::deque<std::vector<std::byte>> answers_;
    std::size_t answer_bytes_ = 0;  // Invariant: the sum over answers_
    std::size_t needed_bytes_ = 0;
    WishQueue wishes_;
};

}  // namespace brickyard
