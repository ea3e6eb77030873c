// The input as a request: as Boost.Beast parses it, or taken apart here. Whatever it says, the answer is one
// of those that docs/protocol.md tells, a page is what the dataset holds, and no name leads out of the
// catalog.
#include <algorithm>
#include <boost/beast/http.hpp>
#include <cstdlib>
#include <cstring>
#include <string>

#include "server/http_routes.h"
#include "stream_messages.h"
#include "tiny_dataset.h"

using namespace brickyard;
namespace http = boost::beast::http;

extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t max_size);

namespace {

void require(bool holds) {
    if (!holds) std::abort();
}

struct World {
    TinyDataset tiny{"tiny", {.payload_bytes = 96}};
    TinyDataset other{"other one", {.payload_bytes = 64}};
    std::unique_ptr<Catalog> catalog;
    BatchPool pool{2 * kBatchBytes};
    AccessTokens nobody_asked, all{"all"}, narrow;
    std::shared_ptr<const BrickStore> stores[2] = {tiny.store(), other.store()};

    World() {
        auto opened = Catalog::open({tiny.folder(), other.folder()}, 2, 1u << 12);
        require(bool(opened));
        catalog = std::move(*opened);
        const auto file = tiny.folder().parent_path() / "tokens";
        std::FILE* out = std::fopen(file.c_str(), "w");
        require(out != nullptr && std::fputs("narrow tiny\n", out) >= 0 && std::fclose(out) == 0);
        auto read = AccessTokens::read(file);
        require(bool(read));
        narrow = std::move(*read);
    }
};

World& world() {
    static World only;
    return only;
}

// Whole lines of "Name: value", so that nothing of a request becomes a header of its own.
void checkHeaders(const std::string& headers) {
    std::size_t at = 0;
    while (at < headers.size()) {
        const auto end = headers.find("\r\n", at);
        require(end != std::string::npos);
        const std::string line = headers.substr(at, end - at);
        require(line.find(": ") != std::string::npos && line.find_first_of("\r\n") == std::string::npos);
        at = end + 2;
    }
}

// Read from the target's text again, in another way than the server does.
void checkPage(const std::string& target, const HttpReply& reply) {
    char name[16] = {}, kind[8] = {};
    unsigned frame = 0, channel = 0, block = 0, node = 0;
    const int found = std::sscanf(target.c_str(), "/v1/datasets/%15[^/]/frames/%u/channels/%u/%7[^/]/%u/%u",
                                  name, &frame, &channel, kind, &block, &node);
    // A path with escapes means the same as one without; there is nothing to compare it with here.
    if (target.find('%') != std::string::npos) return;
    require(found >= 5 && frame == 30 && std::strcmp(name, "tiny") == 0);
    const BrickStore& store = *world().stores[0];
    const auto stored = reply.is_block ? store.readBlock(channel, block) : [&] {
        const auto in = store.loadBlock(channel, block);
        require(bool(in) && node < in->nodeCount());
        return store.readPayload(in->record(node), "fuzz");
    }();
    require(stored && stored->size() == reply.page_bytes &&
            std::memcmp(stored->data(), reply.page.data(), reply.page_bytes) == 0);
}

void check(const std::string& target, const HttpReply& reply, bool full, bool narrow) {
    constexpr unsigned kDocumented[] = {200, 304, 400, 401, 404, 405, 503};
    require(std::ranges::find(kDocumented, reply.status) != std::end(kDocumented));
    require(full || reply.status != 503);
    checkHeaders(reply.headers);
    if (reply.status >= 400) {
        require(!reply.page && reply.body.size() > 1);
        require(reply.body.find('\n') == reply.body.size() - 1);
        require(std::ranges::none_of(reply.body, [](char c) { return c >= 0 && c < ' ' && c != '\n'; }));
    }
    // To who may not see it, it is not there. (An error repeats the name that was asked for.)
    if (narrow && reply.status == 200)
        require(reply.body.find("other one") == std::string::npos && reply.page_bytes != 64);
    if (reply.page && reply.status == 200) checkPage(target, reply);
}

void ask(const HttpRequest& request, unsigned configuration) {
    HttpServices services;
    services.catalog = world().catalog.get();
    const bool narrow = (configuration & 3) == 1;
    services.tokens = narrow                     ? &world().narrow
                      : (configuration & 3) == 2 ? &world().all
                                                 : &world().nobody_asked;
    services.batches = &world().pool;
    services.metrics = [] { return std::string("metrics 1\n"); };
    BatchMemory first, second;
    const bool full = (configuration & 0xc) == 4;
    if (full) first = world().pool.take(), second = world().pool.take();

    const std::string target(request.target.substr(0, request.target.find('?')));
    auto cached = answerHttp(request, services, ReadMode::kCachedOnly);
    if (cached) check(target, *cached, full, narrow);
    const auto whole = answerHttp(request, services, ReadMode::kMayBlock);
    require(whole.has_value());
    check(target, *whole, full, narrow);
    if (!cached) return;
    require(cached->status == whole->status && cached->headers == whole->headers &&
            cached->body == whole->body);
    require(cached->page_bytes == whole->page_bytes);
}

std::string_view viewOf(boost::beast::string_view text) { return {text.data(), text.size()}; }

std::string randomTarget(Dice& dice) {
    static constexpr const char* kParts[] = {
        "healthz",  "metrics", "v1",     "datasets", "tiny",       "other%20one", "frames",  "30",
        "channels", "0",       "1",      "blocks",   "pages",      "draft",       "..%2f..", "%00",
        "..",       "",        "%2e%2e", "-1",       "4294967295", "99999999999"};
    std::string target;
    if (!dice.once(4)) {
        target = "/v1/datasets";
        if (!dice.once(8)) target += dice.once(3) ? "/other%20one" : "/tiny";
        if (!dice.once(8)) target += "/frames/30";
        if (!dice.once(8)) target += dice.once(2) ? "/channels/1" : "/channels/0";
        if (!dice.once(2)) return target + "/blocks/0";
        target += "/pages/0/" + std::to_string(dice.below(80));
    }
    for (std::uint32_t n = dice.below(4); n > 0; --n)
        target += std::string("/") + kParts[dice.below(std::size(kParts))];
    return target;
}

}  // namespace

extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t max_size,
                                               unsigned seed) {
    Dice dice(seed);
    if (!dice.once(8)) return LLVMFuzzerMutate(data, size, max_size);
    std::string input(1, char(dice.below(32)));
    const std::string token = dice.once(2) ? "Bearer narrow" : "Bearer all";
    if ((input[0] & 16) != 0) {
        input += "GET " + randomTarget(dice) + " HTTP/1.1\r\nHost: a\r\nAuthorization: " + token + "\r\n";
        if (dice.once(2)) input += "If-None-Match: *\r\n";
        input += "\r\n";
    } else {
        input += "GET\n" + randomTarget(dice) + "\n" + (dice.once(2) ? "*" : "\"0\"") + "\n" + token;
    }
    if (input.size() > max_size) return LLVMFuzzerMutate(data, size, max_size);
    std::memcpy(data, input.data(), input.size());
    return dice.once(2) ? input.size() : LLVMFuzzerMutate(data, input.size(), max_size);
}

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    if (size == 0) return 0;
    const std::string_view text(reinterpret_cast<const char*>(data + 1), size - 1);
    if ((data[0] & 16) == 0) {
        std::string_view parts[4];
        std::string_view rest = text;
        for (std::string_view& part : parts) {
            const auto end = rest.find('\n');
            part = rest.substr(0, end);
            rest = end == std::string_view::npos ? std::string_view{} : rest.substr(end + 1);
        }
        ask({parts[0], parts[1], parts[2], parts[3]}, data[0]);
        return 0;
    }
    http::request_parser<http::string_body> parser;
    parser.header_limit(16u << 10);
    parser.body_limit(1u << 10);
    boost::system::error_code error;
    parser.put(boost::asio::const_buffer(text.data(), text.size()), error);
    if (error || !parser.is_done()) return 0;
    const auto& message = parser.get();
    ask({viewOf(message.method_string()), viewOf(message.target()),
         viewOf(message[http::field::if_none_match]), viewOf(message[http::field::authorization])},
        data[0]);
    return 0;
}
