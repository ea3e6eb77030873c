// What the server answers to GET and HEAD, without a socket. docs/protocol.md, section "HTTP". Any thread.
#pragma once

#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "server/batch_pool.h"
#include "server/offer.h"

namespace brickyard {

struct HttpRequest {
    std::string_view method;
    std::string_view target;         // as on the request line
    std::string_view if_none_match;  // empty where the header is absent
    std::string_view authorization;
};

struct HttpReply {
    unsigned status = 200;
    std::string headers;  // whole lines, beside Content-Length, Date, Server and Connection
    std::string body;     // also for HEAD; the session leaves it out
    // Instead of `body`, where there is one.
    BatchMemory page;
    std::size_t page_bytes = 0;
    std::string_view route = "other";  // for the metrics; static
    bool is_block = false;             // of the page
};

struct HttpServices {
    const Catalog* catalog = nullptr;
    const AccessTokens* tokens = nullptr;
    BatchPool* batches = nullptr;
    std::function<std::string()> metrics;  // the text of /metrics
};

// kCachedOnly: nothing where the answer needs the disk; ask again where that may be waited for.
std::optional<HttpReply> answerHttp(const HttpRequest& request, const HttpServices& services, ReadMode mode);

}  // namespace brickyard
