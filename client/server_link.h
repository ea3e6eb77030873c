// One connection to one server, shared by the sources of its datasets: greets, opens, dispatches what comes,
// and makes the connection anew when it is lost.
//
//     greeting --Welcome--> serving --lost--> away --Welcome--> serving
//         |                    |                |
//         +--------------------+----------------+--refused, patience over--> lost
//
// The network thread receives; the sources' threads call. All of it, and every DatasetStream that has joined,
// is guarded by `mutex`. docs/protocol.md; docs/client.md, "Threads". server_link.cpp: the connection and
// what is sent; server_link_answers.cpp: what comes.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <random>
#include <string>
#include <vector>

#include "client/dataset_stream.h"
#include "client/stream_connection.h"
#include "client/wish_turns.h"

namespace brickyard {

class NetworkThread;

class ServerLink {
public:
    // Limit of docs/protocol.md; what is over it would end the connection.
    static constexpr std::size_t kMaxOpenDatasets = 16;

    // `alone`: the first stream is the only one, and its hint may go with the greeting. On a connection that
    // others use, a hint for a dataset that is not there must not cost them the connection: it waits for the
    // answer to Open.
    ServerLink(StreamAddress address, std::string token, StreamTimeouts timeouts,
               std::shared_ptr<NetworkThread> thread, bool alone);
    // No stream is joined any more.
    ~ServerLink();
    ServerLink(const ServerLink&) = delete;
    ServerLink& operator=(const ServerLink&) = delete;

    std::mutex mutex;

    // REQUIRES from here on: the mutex is held.

    // Opens the stream's dataset, in the background. Errors: kInvalid (over kMaxOpenDatasets).
    Result<void> join(DatasetStream& stream);
    void leave(DatasetStream& stream);
    // Asks for `stream.opening`, now or as soon as the dataset is open.
    void askFrame(DatasetStream& stream);
    // Sends `stream.wanted` when its turn comes.
    void sendWish(DatasetStream& stream);
    // A part of the arrivals was taken: the reading goes on where it was held back for that.
    void resume(DatasetStream& stream);

    // Why this stream gets nothing more; nullptr while it may.
    const Error* failure(const DatasetStream& stream) const;
    // Waits on `stream.changed` until `ready()` or until the stream has failed; false where `deadline` passed
    // first. Where an answer is `owed`, the time that a server may take for one is watched too: what is over
    // it is kTimeout, on the whole connection.
    template <class Ready>
    bool wait(std::unique_lock<std::mutex>& lock, DatasetStream& stream, SourceDeadline deadline, bool owed,
              const std::string& awaited, Ready ready) {
        const auto begin = std::chrono::steady_clock::now();
        while (!ready() && !failure(stream)) {
            stream.changed.wait_until(lock, std::min(deadline, patienceEnd(begin, owed)));
            const auto now = std::chrono::steady_clock::now();
            if (ready() || failure(stream)) break;
            if (now >= deadline) return false;
            if (now >= patienceEnd(begin, owed)) loseSilent(awaited);
        }
        return true;
    }

    std::string urlOf(const DatasetStream& stream) const;
    // The datasets there are, where the server has told since they changed.
    const std::optional<std::vector<std::string>>& catalog() const { return catalog_; }
    const StreamTimeouts& timeouts() const { return timeouts_; }

private:
    struct Question {
        enum class Kind { kOpen, kFrame, kFrameAgain } kind;
        DatasetStream* stream;  // nullptr: gone
        std::uint64_t number = 0;
    };

    // On the network thread.
    void connect(std::chrono::milliseconds delay);
    void greet();
    bool receive(std::span<const std::byte> message);
    std::vector<std::byte> nextMessage();
    void onLost(Error error);

    void onWelcome(const Welcome& welcome);
    void onFrameOpened(const FrameOpened& opened);
    void onPage(std::uint64_t epoch, std::uint32_t frame, const WishedPage& page,
                Result<std::span<const std::byte>> payload);
    void onFailed(const Failed& failed);
    void onDatasetChanged(const DatasetChanged& change);
    void finishWish(std::uint64_t epoch, bool credit_exhausted);

    void send(const StreamHeader& header);
    void ask(Question::Kind kind, DatasetStream& stream);
    // The dataset is open: what its stream waits for.
    void serve(DatasetStream& stream);
    void sendEarly(DatasetStream& stream, std::uint32_t dataset_id);
    void settled();
    std::optional<Question> answered(Question::Kind kind);
    SourceDeadline patienceEnd(SourceDeadline begin, bool owed) const;
    void loseSilent(const std::string& awaited);
    // The first reason is the cause; what follows is only its consequence.
    void lose(Error error);
    void loseTo(ErrorCode code, const std::string& why);
    void loseStream(DatasetStream& stream, Error error);
    void wakeAll();

    const StreamAddress address_;
    const std::string token_;
    const StreamTimeouts timeouts_;
    const std::shared_ptr<NetworkThread> thread_;
    const bool alone_;

    std::vector<DatasetStream*> streams_;  // in the order in which they joined
    std::optional<Error> lost_;
    bool closing_ = false;
    std::optional<std::vector<std::string>> catalog_;

    // Of the present connection.
    bool open_ = false;  // on_open has come
    std::map<std::string, std::uint32_t> dataset_ids_;
    std::uint32_t server_minor_ = 0;
    std::deque<Question> questions_;  // answers come in this order
    std::deque<std::vector<std::byte>> outbox_;
    WishTurns turns_;
    bool served_ = false;  // a page came, or a wish was done
    std::chrono::steady_clock::time_point last_heard_;

    // Of making it anew.
    bool established_ = false;  // a dataset was open once
    bool early_ = false;        // a hint went out on this connection
    std::optional<std::chrono::steady_clock::time_point> away_since_;
    std::chrono::milliseconds delay_{};
    std::string away_why_;
    std::minstd_rand random_{std::random_device{}()};

    std::unique_ptr<StreamConnection> connection_;
};

}  // namespace brickyard
