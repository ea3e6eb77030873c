#include "server/http_routes.h"

#include <fmt/format.h>
#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <charconv>
#include <optional>
#include <set>
#include <span>

#include "core/percent_code.h"
#include "proto/stream.pb.h"
#include "server/conversation.h"

namespace brickyard {
namespace {

// Pages and blocks are immutable; a manifest grows.
constexpr const char* kImmutable = "public, max-age=31536000, immutable";
constexpr const char* kRevalidate = "no-cache";

HttpReply text(unsigned status, std::string line) {
    return {status,
            {{"Content-Type", "text/plain; charset=utf-8"}, {"Cache-Control", "no-store"}},
            std::move(line) + "\n"};
}

HttpReply failed(const Error& error) {
    return text(error.code == ErrorCode::kNotFound  ? 404
                : error.code == ErrorCode::kInvalid ? 400
                                                    : 500,
                error.message);
}

std::string etagOf(std::uint64_t checksum) { return fmt::format("\"{:016x}\"", checksum); }

std::span<const std::byte> bytesOf(const std::string& text) { return std::as_bytes(std::span(text)); }

// If-None-Match: a list of tags or "*"; W/ makes no difference for GET (RFC 9110, section 13.1.2).
bool matches(std::string_view list, std::string_view etag) {
    while (!list.empty()) {
        const auto comma = list.find(',');
        std::string_view tag = list.substr(0, comma);
        list = comma == std::string_view::npos ? std::string_view{} : list.substr(comma + 1);
        while (!tag.empty() && tag.front() == ' ') tag.remove_prefix(1);
        while (!tag.empty() && tag.back() == ' ') tag.remove_suffix(1);
        if (tag.starts_with("W/")) tag.remove_prefix(2);
        if (tag == etag || tag == "*") return true;
    }
    return false;
}

HttpReply document(const HttpRequest& request, std::string type, const char* caching, std::uint64_t checksum,
                   std::string body) {
    HttpReply reply;
    const std::string etag = etagOf(checksum);
    reply.headers = {{"ETag", etag}, {"Cache-Control", caching}};
    if (matches(request.if_none_match, etag)) {
        reply.status = 304;
        return reply;
    }
    reply.headers.emplace_back("Content-Type", std::move(type));
    reply.body = std::move(body);
    return reply;
}

HttpReply json(const HttpRequest& request, const google::protobuf::Message& message,
               std::optional<std::uint64_t> known_checksum = {}) {
    std::string body;
    google::protobuf::util::JsonPrintOptions print;
    print.preserve_proto_field_names = true;
    print.always_print_primitive_fields = true;
    if (!google::protobuf::util::MessageToJsonString(message, &body, print).ok())
        return text(500, "this answer cannot be written as JSON; use the stream");
    body += '\n';
    const std::uint64_t sum = known_checksum ? *known_checksum : checksum(bytesOf(body));
    return document(request, "application/json", kRevalidate, sum, std::move(body));
}

HttpReply stored(const HttpRequest& request, std::uint64_t sum, const Result<std::vector<std::byte>>& bytes) {
    if (!bytes) return failed(bytes.error());
    return document(request, "application/octet-stream", kImmutable, sum,
                    std::string(reinterpret_cast<const char*>(bytes->data()), bytes->size()));
}

std::optional<std::uint32_t> numberOf(const std::string& text) {
    std::uint32_t number = 0;
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data(), end, number);
    if (error != std::errc{} || stop != end || text.empty()) return std::nullopt;
    return number;
}

// "/a/b%20c?x" as {"a", "b c"}. Names only ever look something up in the catalog and never become paths.
Result<std::vector<std::string>> splitTarget(std::string_view target) {
    target = target.substr(0, target.find('?'));
    if (!target.starts_with('/'))
        return fail(ErrorCode::kInvalid, "the request's target does not begin with '/'");
    std::vector<std::string> parts;
    while (!target.empty()) {
        target.remove_prefix(1);
        const auto slash = target.find('/');
        auto part = percentDecode(target.substr(0, slash));
        if (!part) return tl::unexpected(part.error());
        parts.push_back(std::move(*part));
        target = slash == std::string_view::npos ? std::string_view{} : target.substr(slash);
    }
    return parts;
}

HttpReply listing(const HttpRequest& request, const Catalog& catalog) {
    CatalogListing listing;
    for (const std::string& name : catalog.names()) {
        const auto dataset = catalog.dataset(name);
        if (!dataset) continue;
        CatalogEntry& entry = *listing.add_datasets();
        entry.set_name(name);
        std::set<std::string> seen;
        for (const FrameEntry& frame : (*dataset)->manifest().frames()) {
            entry.add_frames(frame.frame());
            for (const ChannelSummary& channel : frame.channels())
                if (seen.insert(channel.name()).second) entry.add_channels(channel.name());
        }
    }
    return json(request, listing);
}

HttpReply frameResource(const HttpRequest& request, const FrameReader& frame,
                        std::span<const std::string> rest) {
    if (rest.empty()) return json(request, frame.footer(), frame.store().footerChecksum());
    // channels/C/blocks/B or channels/C/pages/B/N[/draft]
    const bool is_block = rest.size() == 4 && rest[2] == "blocks";
    const bool is_draft = rest.size() == 6 && rest[5] == "draft";
    const bool is_page = (rest.size() == 5 || is_draft) && rest[2] == "pages";
    if (rest[0] != "channels" || !(is_block || is_page))
        return text(404, "nothing here; a frame has channels/C/blocks/B and channels/C/pages/B/N[/draft]");
    const auto channel = numberOf(rest[1]), block = numberOf(rest[3]);
    const auto node = is_page ? numberOf(rest[4]) : std::optional<std::uint32_t>(0);
    if (!channel || !block || !node) return text(400, "channel, block and node are whole numbers from 0");

    if (is_block) {
        if (const auto known = frame.storedBlockBytes(*channel, *block); !known) return failed(known.error());
        const BlockRef& ref = frame.footer().channels(int(*channel)).blocks(int(*block));
        return stored(request, ref.xxh64(), frame.store().readBlock(*channel, *block));
    }
    const auto record = frame.findBrick({*channel, *block, *node, is_draft});
    if (!record) return failed(record.error());
    return stored(request, is_draft ? record->draft_checksum : record->payload_checksum,
                  frame.readBrick(*record, is_draft));
}

}  // namespace

HttpReply answerHttp(const HttpRequest& request, const Catalog& catalog, const ServerOptions& options) {
    if (request.method != "GET" && request.method != "HEAD") {
        auto reply = text(405, "only GET and HEAD are answered here");
        reply.headers.emplace_back("Allow", "GET, HEAD");
        return reply;
    }
    const auto parts = splitTarget(request.target);
    if (!parts) return failed(parts.error());
    const std::span<const std::string> path = *parts;
    if (path.size() == 1 && path[0] == "healthz") return text(200, "ok");
    if (path.size() < 2 || path[0] != "v1" || path[1] != "datasets")
        return text(404, "nothing here; see /v1/datasets, or open a WebSocket for the stream");

    if (!options.token.empty()) {
        constexpr std::string_view kScheme = "Bearer ";
        const std::string_view given = request.authorization;
        if (!given.starts_with(kScheme) || !tokensMatch(options.token, given.substr(kScheme.size()))) {
            auto reply = text(401, "this server asks for a token; send \"Authorization: Bearer TOKEN\"");
            reply.headers.emplace_back("WWW-Authenticate", "Bearer");
            return reply;
        }
    }
    if (path.size() == 2) return listing(request, catalog);
    const auto dataset = catalog.dataset(path[2]);
    if (!dataset) return failed(dataset.error());
    if (path.size() == 3) return json(request, (*dataset)->manifest());
    if (path[3] != "frames" || path.size() == 4) return text(404, "nothing here; a dataset has frames/F");
    const auto number = numberOf(path[4]);
    if (!number) return text(400, "a frame is a whole number from 0");
    const auto frame = catalog.frame(path[2], *number);
    if (!frame) return failed(frame.error());
    return frameResource(request, **frame, path.subspan(5));
}

}  // namespace brickyard
