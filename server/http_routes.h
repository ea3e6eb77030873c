// What the server answers to GET and HEAD, without a socket. docs/protocol.md, section "HTTP". Any thread.
#pragma once

#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "server/catalog.h"
#include "server/server_options.h"

namespace brickyard {

struct HttpRequest {
    std::string method;
    std::string target;         // as on the request line
    std::string if_none_match;  // empty where the header is absent
    std::string authorization;
};

struct HttpReply {
    unsigned status = 200;
    std::vector<std::pair<std::string, std::string>> headers;  // beside Content-Length and Server
    std::string body;                                          // also for HEAD; the session leaves it out
};

HttpReply answerHttp(const HttpRequest& request, const Catalog& catalog, const ServerOptions& options);

}  // namespace brickyard
