// What a client that reads slowly still gets of a wish that it has replaced. One thread.
#pragma once

#include <cstdint>

#include "core/result.h"
#include "tools/bench/raw_stream.h"
#include "tools/bench/served_subject.h"

namespace brickyard {

struct StalePages {
    std::uint64_t old_bytes = 0;  // of the older wish, that came after the new one was sent
    // What the kernel's sockets held at that moment, and 50 ms later; 0 where that cannot be seen.
    std::uint64_t held_bytes = 0, held_later_bytes = 0;
    // Of old_bytes: what cannot have been in the sockets when the new wish was sent; and what cannot have
    // been there 50 ms later, which is what the server still handed over then.
    std::uint64_t beyond_held = 0, beyond_held_later = 0;
    double first_new_ms = 0;  // from sending the new wish to the first whole page of it
};

// Wishes for every page with endless credit, reads for a while, and wishes for some others. `through_proxy`:
// the sockets at its other side cannot be seen. Errors: kIo; kTimeout (no page of the new wish).
Result<StalePages> measureStalePages(std::uint16_t port, const std::string& dataset,
                                     const SubjectFrame& frame, const RawStreamOptions& how,
                                     double bytes_per_second, bool through_proxy);

}  // namespace brickyard
