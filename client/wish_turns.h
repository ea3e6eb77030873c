// Whose wish is at the server. A connection has one wish, the newest; where several sources share it they
// take turns:
//
// - A source that wishes while another's wish is at the server takes its place at once; that one goes to the
//   end of the line with what has not come yet. Nothing is lost by that: what is on the way still arrives.
// - While others wait, a turn is a slice of kTurnBytes, and the rest goes to the end of the line.
// - What a camera sees cannot be asked for in parts, nor a page that is larger than a slice: such a wish is
//   left alone until it is done.
//
// Not thread-safe: guarded by the mutex of the ServerLink.
#pragma once

#include <cstdint>
#include <deque>
#include <optional>
#include <utility>

#include "client/dataset_stream.h"

namespace brickyard {

class WishTurns {
public:
    static constexpr std::uint64_t kTurnBytes = 1u << 20;
    static constexpr int kTurnPages = 4096;

    // `stream.wanted` is new, or is to be asked for again. A stream that waits in the line keeps its place.
    void enter(DatasetStream& stream);
    // Its wish is of no more use. True where it is still at the server with nobody to replace it.
    bool leave(DatasetStream& stream);
    // The connection is a new one: what was at the server is first in the line.
    void restart();
    // Marks a wish that was sent otherwise, with the greeting.
    void sent(DatasetStream& stream);

    // The next wish to send, or nothing: there is none, or one is at the server and may finish.
    std::optional<Wish> next();
    // The one that a page of this epoch is for; nullptr where it is gone.
    DatasetStream* ownerOf(std::uint64_t epoch);
    // The server has no more of this epoch. True where the owner's whole wish is done with it.
    bool finish(std::uint64_t epoch, bool credit_exhausted);
    std::uint64_t nextEpoch() { return ++epoch_; }

private:
    bool inLine(const DatasetStream& stream) const;

    std::deque<DatasetStream*> line_;
    DatasetStream* holder_ = nullptr;
    bool sliced_ = false;              // the holder's wish was sent in part
    bool cut_ = false;                 // of its list, only the front
    bool unbroken_ = false;            // it is left alone until it is done
    std::uint64_t left_before_ = 0;    // its credit when it was sent
    DatasetStream* hungry_ = nullptr;  // got nothing out of a slice: its next page is larger than one
    std::uint64_t epoch_ = 0;
    std::deque<std::pair<std::uint64_t, DatasetStream*>> owners_;  // rising by epoch
};

}  // namespace brickyard
