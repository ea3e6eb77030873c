// One client's side of the stream, without its socket: messages in, messages out. docs/protocol.md, "States".
// One thread at a time; whoever owns the socket calls receive() for each message that came and writes what
// next() gives, one at a time, so that a new wish overtakes everything but the message that is being written.
#pragma once

#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/frame_reader.h"
#include "server/catalog.h"
#include "server/server_options.h"
#include "server/wish_queue.h"

namespace brickyard {

// Limits of stream.proto.
inline constexpr int kMaxWishPages = 65536;
inline constexpr int kMaxWishBlocks = 4096;
inline constexpr int kMaxWishChannels = 64;
inline constexpr std::uint32_t kMaxPictureEdge = 65536;
inline constexpr std::size_t kMaxOpenDatasets = 16;
inline constexpr std::size_t kMaxTokenBytes = 4096;
inline constexpr std::size_t kMaxClientNameBytes = 256;
inline constexpr std::size_t kMaxDatasetNameBytes = 1024;

class Conversation {
public:
    Conversation(const Catalog& catalog, const ServerOptions& options)
        : catalog_(catalog), options_(options) {}

    // A whole binary message. Answers are queued, wishes replace each other. REQUIRES: !over().
    void receive(std::span<const std::byte> message);
    // The peer broke the protocol below the messages (too long, text, too slow): tell it, then end.
    void refuse(const std::string& why) { end(Failed::REASON_PROTOCOL, why); }

    // What to write next, or nothing for now. Reads from the disk.
    std::optional<OutMessage> next();

    // A dataset was opened: what follows may take as long as it likes.
    bool established() const { return !datasets_.empty(); }
    // So many answers wait that no more should be read until some are written.
    bool backlogged() const { return answers_.size() >= kMaxAnswers; }
    // Nothing more is received; when next() gives nothing, close.
    bool over() const { return over_; }
    // Program and version that the client gave, for the log; printable.
    const std::string& clientName() const { return client_name_; }

private:
    static constexpr std::size_t kMaxAnswers = 16;

    void onHello(const Hello& hello);
    void onOpen(const Open& open);
    void onOpenFrame(const OpenFrame& open_frame);
    void onWish(const Wish& wish);
    void answer(const StreamHeader& header);
    // Failed, and the connection goes on.
    void fail(const Failed& failed);
    // Failed, and it is the last message.
    void end(Failed::Reason reason, const std::string& why);

    const Catalog& catalog_;
    const ServerOptions& options_;
    bool greeted_ = false;
    bool over_ = false;
    std::string client_name_;
    std::vector<std::string> datasets_;   // the dataset with id i + 1
    std::optional<std::uint64_t> epoch_;  // of the newest wish
    std::deque<OutMessage> answers_;
    WishQueue wishes_;
};

// Takes as long for a wrong first byte as for a wrong last one.
bool tokensMatch(std::string_view expected, std::string_view given);

}  // namespace brickyard
