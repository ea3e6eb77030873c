// Answers one wish over one frame, page by page, in the order of the wish and within its credit. Whoever
// answers (a server, a local source) asks for the next step when it has room for one. One thread at a time.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <unordered_set>
#include <vector>

#include "core/frame_reader.h"
#include "core/page_wish.h"
#include "core/result.h"
#include "core/view_descent.h"

namespace brickyard {

// More credit than this counts as this: it bounds the list that a view becomes.
inline constexpr std::uint64_t kMaxWishBytes = 4ull << 30;

class WishWalk {
public:
    struct Step {
        WishedPage page;
        Result<std::vector<std::byte>> bytes;  // stored bytes; or why this page cannot be had
    };

    // Errors: kInvalid (a view whose camera cannot be, or whose channels do not exist).
    static Result<WishWalk> create(std::shared_ptr<const FrameReader> frame, PageWish wish);

    // The next page; nothing when all are sent or when the next one is more than the credit that is left:
    // pages are not skipped for smaller ones behind them. Reads from the disk. A page that cannot be had
    // costs no credit.
    std::optional<Step> next();

    // The same in two steps, for whoever has memory of its own for the bytes and may not always wait.
    struct Planned {
        WishedPage page;
        Result<std::uint32_t> bytes;  // stored size; or why this page cannot be had
    };
    enum class Plan {
        kPage,  // planned() is the next page
        kDone,
        kWaits,  // only where the disk must not be waited for: finding the page needs the disk
    };
    // Finds the next page, or stays at the one that is planned already.
    Plan plan(ReadMode mode);
    // REQUIRES: plan() gave kPage.
    const Planned& planned() const { return *planned_; }
    // Reads the planned page, and goes on behind it unless the error is kWouldBlock. REQUIRES:
    // planned().bytes is a size, and out has it.
    Result<void> readPlanned(std::span<std::byte> out, ReadMode mode);
    // Memory of the view that is being looked at, beside the list; and its end, where that is too much.
    std::size_t viewBytes() const;
    void dropView();
    // Goes on behind a planned page that cannot be had.
    void skipPlanned() { planned_.reset(); }

    // After next() gave nothing: whether that was for lack of credit.
    bool creditExhausted() const { return credit_exhausted_; }
    std::uint64_t sentBytes() const { return sent_bytes_; }

private:
    WishWalk(std::shared_ptr<const FrameReader> frame, PageWish wish)
        : frame_(std::move(frame)), wish_(std::move(wish)) {}
    struct ChannelDescent {
        std::uint32_t channel = 0;
        ViewDescent descent;
        std::uint64_t bytes = 0;  // of its steps so far
        std::optional<DescentStep> next;
        bool over = false;
    };
    void beginView();
    void descend();
    // Nothing where the credit is used up.
    std::optional<Planned> look(const WishedPage& page, ReadMode mode);

    std::shared_ptr<const FrameReader> frame_;
    PageWish wish_;
    std::size_t next_page_ = 0;
    std::size_t next_view_ = 0;
    std::vector<PinholeCamera> cameras_;    // one per view
    std::vector<ChannelDescent> descents_;  // of the next view
    std::unordered_set<PageAddress, PageAddressHash> listed_blocks_, listed_bricks_;
    std::optional<Planned> planned_;
    NodeRecord record_;             // of the planned page where it is a brick
    std::uint64_t sent_bytes_ = 0;  // Invariant: at most wish_.credit_bytes
    bool credit_exhausted_ = false;
};

}  // namespace brickyard
