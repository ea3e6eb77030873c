#include "server/http_routes.h"

#include <fmt/format.h>
#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <deque>
#include <optional>
#include <set>
#include <span>
#include <vector>

#include "core/percent_code.h"
#include "proto/stream.pb.h"

namespace brickyard {
namespace {

// Pages and blocks are immutable; a manifest grows.
constexpr const char* kImmutable = "public, max-age=31536000, immutable";
constexpr const char* kRevalidate = "no-cache";

constexpr const char* kBinary = "Content-Type: application/octet-stream\r\n";

HttpReply text(unsigned status, std::string line) {
    HttpReply reply;
    reply.status = status;
    reply.headers = "Content-Type: text/plain; charset=utf-8\r\nCache-Control: no-store\r\n";
    reply.body = std::move(line) + "\n";
    return reply;
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

std::string cachingHeaders(std::string_view etag, const char* caching) {
    return fmt::format("ETag: {}\r\nCache-Control: {}\r\n", etag, caching);
}

HttpReply notModified(std::string_view etag, const char* caching) {
    HttpReply reply;
    reply.status = 304;
    reply.headers = cachingHeaders(etag, caching);
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
    const std::string etag = etagOf(sum);
    if (matches(request.if_none_match, etag)) return notModified(etag, kRevalidate);
    HttpReply reply;
    reply.headers = cachingHeaders(etag, kRevalidate) + "Content-Type: application/json\r\n";
    reply.body = std::move(body);
    return reply;
}

std::optional<std::uint32_t> numberOf(std::string_view text) {
    std::uint32_t number = 0;
    const char* end = text.data() + text.size();
    const auto [stop, error] = std::from_chars(text.data(), end, number);
    if (error != std::errc{} || stop != end || text.empty()) return std::nullopt;
    return number;
}

// The parts of "/a/b%20c?x": "a", "b c". Names only ever look something up in the catalog and never become
// paths.
class TargetPath {
public:
    static constexpr std::size_t kMaxParts = 12;  // more than any resource has

    // Errors: kInvalid; kNotFound (too deep for anything that is here).
    static Result<std::unique_ptr<TargetPath>> parse(std::string_view target) {
        target = target.substr(0, target.find('?'));
        if (!target.starts_with('/'))
            return fail(ErrorCode::kInvalid, "the request's target does not begin with '/'");
        auto path = std::make_unique<TargetPath>();
        while (!target.empty()) {
            target.remove_prefix(1);
            const auto slash = target.find('/');
            std::string_view part = target.substr(0, slash);
            if (part.find('%') != std::string_view::npos) {
                auto decoded = percentDecode(part);
                if (!decoded) return tl::unexpected(decoded.error());
                part = path->decoded_.emplace_back(std::move(*decoded));
            } else if (part.find('\0') != std::string_view::npos) {
                return fail(ErrorCode::kInvalid, "a name holds a zero byte; remove it");
            }
            if (path->count_ == kMaxParts)
                return fail(ErrorCode::kNotFound, "nothing here; see /v1/datasets for what there is");
            path->parts_[path->count_++] = part;
            target = slash == std::string_view::npos ? std::string_view{} : target.substr(slash);
        }
        return path;
    }
    std::span<const std::string_view> parts() const { return {parts_.data(), count_}; }

private:
    std::array<std::string_view, kMaxParts> parts_;
    std::size_t count_ = 0;
    std::deque<std::string> decoded_;  // whose bytes parts_ may point to
};

HttpReply listing(const HttpRequest& request, const Offer& offer) {
    CatalogListing listing;
    for (const std::string& name : offer.names()) {
        const auto dataset = offer.dataset(name);
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

// channels/C/blocks/B or channels/C/pages/B/N[/draft]
struct PagePath {
    bool is_block = false;
    PageAddress address;
};

std::optional<HttpReply> page(const HttpRequest& request, const FrameReader& frame, const PagePath& path,
                              const HttpServices& services, ReadMode mode) {
    const PageAddress& at = path.address;
    std::uint64_t sum = 0;
    std::size_t bytes = 0;
    NodeRecord record;
    if (path.is_block) {
        if (const auto known = frame.storedBlockBytes(at.channel, at.block); !known)
            return failed(known.error());
        const BlockRef& ref = frame.footer().channels(int(at.channel)).blocks(int(at.block));
        sum = ref.xxh64();
        bytes = ref.bytes();
    } else {
        const auto found = frame.findBrick(at, mode);
        if (!found && found.error().code == ErrorCode::kWouldBlock) return std::nullopt;
        if (!found) return failed(found.error());
        record = *found;
        sum = at.draft ? record.draft_checksum : record.payload_checksum;
        bytes = at.draft ? record.draft_bytes : record.payload_bytes;
    }
    const std::string etag = etagOf(sum);
    if (matches(request.if_none_match, etag)) return notModified(etag, kImmutable);
    HttpReply reply;
    reply.page_bytes = bytes;
    reply.is_block = path.is_block;
    reply.page = services.batches->take(bytes);
    if (!reply.page) {
        auto busy = text(503, "the server is sending all that it may hold in memory; try again");
        busy.headers += "Retry-After: 1\r\n";
        return busy;
    }
    const std::span<std::byte> out(reply.page.data(), bytes);
    const auto read = path.is_block ? frame.store().readBlockInto(at.channel, at.block, out, mode)
                                    : frame.store().readPayloadInto(record, out, mode);
    if (!read && read.error().code == ErrorCode::kWouldBlock) return std::nullopt;
    if (!read) return failed(read.error());
    reply.headers = cachingHeaders(etag, kImmutable) + kBinary;
    return reply;
}

// What lies below /v1/datasets/NAME/frames/F; nothing where that is the frame itself.
Result<std::optional<PagePath>> pagePathOf(std::span<const std::string_view> rest) {
    if (rest.empty()) return std::optional<PagePath>();
    PagePath path;
    path.is_block = rest.size() == 4 && rest[2] == "blocks";
    path.address.draft = rest.size() == 6 && rest[5] == "draft";
    const bool is_page = (rest.size() == 5 || path.address.draft) && rest[2] == "pages";
    if (rest[0] != "channels" || !(path.is_block || is_page))
        return fail(ErrorCode::kNotFound,
                    "nothing here; a frame has channels/C/blocks/B and channels/C/pages/B/N[/draft]");
    const auto channel = numberOf(rest[1]), block = numberOf(rest[3]);
    const auto node = is_page ? numberOf(rest[4]) : std::optional<std::uint32_t>(0);
    if (!channel || !block || !node)
        return fail(ErrorCode::kInvalid, "channel, block and node are whole numbers from 0");
    path.address.channel = *channel;
    path.address.block = *block;
    path.address.node = *node;
    return std::optional(path);
}

// Nothing where the request may not come in.
std::optional<Access> accessOf(const HttpRequest& request, const AccessTokens& tokens) {
    if (!tokens.required()) return Access{};
    constexpr std::string_view kScheme = "Bearer ";
    if (!request.authorization.starts_with(kScheme) ||
        request.authorization.size() > kScheme.size() + AccessTokens::kMaxTokenBytes)
        return std::nullopt;
    const Access* found = tokens.find(request.authorization.substr(kScheme.size()));
    return found == nullptr ? std::nullopt : std::optional(*found);
}

std::optional<HttpReply> datasetResource(const HttpRequest& request, std::span<const std::string_view> path,
                                         const Offer& offer, const HttpServices& services, ReadMode mode) {
    if (path.size() <= 3 || path[3] != "frames" || path.size() == 4) {
        if (mode == ReadMode::kCachedOnly) return std::nullopt;
        const auto dataset = offer.dataset(std::string(path[2]));
        if (!dataset) return failed(dataset.error());
        if (path.size() != 3) return text(404, "nothing here; a dataset has frames/F");
        auto reply = json(request, (*dataset)->manifest());
        reply.route = "manifest";
        return reply;
    }
    const auto number = numberOf(path[4]);
    if (!number) return text(400, "a frame is a whole number from 0");
    const auto wanted = pagePathOf(path.subspan(5));
    if (!wanted) return failed(wanted.error());
    const std::string name(path[2]);
    std::shared_ptr<const FrameReader> frame = offer.openedFrame(name, *number);
    // A footer is asked for by those who want to know whether it changed.
    if (!frame || !*wanted) {
        if (mode == ReadMode::kCachedOnly) return std::nullopt;
        const auto opened = offer.frame(name, *number);
        if (!opened) return failed(opened.error());
        frame = opened->reader;
    }
    if (!*wanted) {
        auto reply = json(request, frame->footer(), frame->store().footerChecksum());
        reply.route = "footer";
        return reply;
    }
    auto reply = page(request, *frame, **wanted, services, mode);
    if (reply) reply->route = "page";
    return reply;
}

}  // namespace

std::optional<HttpReply> answerHttp(const HttpRequest& request, const HttpServices& services, ReadMode mode) {
    if (request.method != "GET" && request.method != "HEAD") {
        auto reply = text(405, "only GET and HEAD are answered here");
        reply.headers += "Allow: GET, HEAD\r\n";
        return reply;
    }
    const auto target = TargetPath::parse(request.target);
    if (!target) return failed(target.error());
    const std::span<const std::string_view> path = (*target)->parts();
    if (path.size() == 1 && path[0] == "healthz") {
        auto reply = text(200, "ok");
        reply.route = "healthz";
        return reply;
    }
    const bool is_metrics = path.size() == 1 && path[0] == "metrics" && services.metrics;
    if (!is_metrics && (path.size() < 2 || path[0] != "v1" || path[1] != "datasets"))
        return text(404, "nothing here; see /v1/datasets, or open a WebSocket for the stream");

    const auto access = accessOf(request, *services.tokens);
    // What counts all datasets is for those who may see them all.
    if (!access || (is_metrics && !access->datasets.empty())) {
        auto reply = text(401, "this server asks for a token; send \"Authorization: Bearer TOKEN\"");
        reply.headers += "WWW-Authenticate: Bearer\r\n";
        return reply;
    }
    if (is_metrics) {
        if (mode == ReadMode::kCachedOnly) return std::nullopt;
        HttpReply reply;
        reply.headers =
            "Content-Type: text/plain; version=0.0.4; charset=utf-8\r\nCache-Control: no-store\r\n";
        reply.body = services.metrics();
        reply.route = "metrics";
        return reply;
    }
    const Offer offer(*services.catalog, *access);
    if (path.size() > 2) return datasetResource(request, path, offer, services, mode);
    if (mode == ReadMode::kCachedOnly) return std::nullopt;
    auto reply = listing(request, offer);
    reply.route = "datasets";
    return reply;
}

}  // namespace brickyard
