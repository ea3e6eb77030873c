// How anything that touches files, peers or users fails: a value or an Error with one line for a person.
#pragma once

#include <string>
#include <tl/expected.hpp>
#include <utility>

namespace brickyard {

enum class ErrorCode {
    kInvalid,      // what the user or a peer gave cannot be meant
    kNotFound,     // no such file, frame, channel, dataset or page
    kCorrupt,      // lengths, magic or checksums do not hold
    kTooNew,       // a format or protocol major version above ours
    kUnsupported,  // sound, but not something we convert or draw
    kIo,           // the operating system said no
    kRefused,      // a peer said no
    kTimeout,
    kWouldBlock,  // only the disk has it, and the caller asked not to wait for the disk
};

// `message` is one line: what, where, what to do.
struct Error {
    ErrorCode code;
    std::string message;
};

template <class T>
using Result = tl::expected<T, Error>;

inline tl::unexpected<Error> fail(ErrorCode code, std::string message) {
    return tl::unexpected<Error>(Error{code, std::move(message)});
}

}  // namespace brickyard
