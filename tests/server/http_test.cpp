// The HTTP side, over real sockets.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <google/protobuf/util/json_util.h>

#include <thread>

#include "core/brick_store.h"
#include "proto/stream.pb.h"
#include "raw_socket.h"
#include "server/server.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

using testing::HasSubstr;
using testing::Not;

class HttpTest : public testing::Test {
protected:
    void SetUp() override { start({}); }

    void start(ServerOptions options) {
        server_.reset();
        options.port = 0;
        auto catalog = Catalog::open({tiny_.folder(), spaced_.folder()}, 8, 1u << 20);
        ASSERT_TRUE(catalog) << catalog.error().message;
        auto server = Server::start(std::move(*catalog), options);
        ASSERT_TRUE(server) << server.error().message;
        server_ = std::move(*server);
    }
    RawReply get(std::string_view target, std::string_view headers = "") {
        return request(server_->port(), "GET", target, headers);
    }
    static std::string etagOf(const RawReply& reply) {
        const auto at = reply.head.find("ETag: ");
        return at == std::string::npos ? "" : reply.head.substr(at + 6, reply.head.find("\r\n", at) - at - 6);
    }

    TinyDataset tiny_{"tiny", {.frames = {7, 30}}};
    TinyDataset spaced_{"my plume", {.frames = {1}}};
    std::unique_ptr<Server> server_;
};

TEST_F(HttpTest, SaysThatItIsHealthy) {
    const auto reply = get("/healthz");
    EXPECT_EQ(reply.status, 200);
    EXPECT_EQ(reply.body, "ok\n");
}

TEST_F(HttpTest, ListsItsDatasets) {
    const auto reply = get("/v1/datasets");
    EXPECT_THAT(reply.head, HasSubstr("application/json"));
    CatalogListing listing;
    ASSERT_TRUE(google::protobuf::util::JsonStringToMessage(reply.body, &listing).ok()) << reply.body;
    ASSERT_EQ(listing.datasets_size(), 2);
    EXPECT_EQ(listing.datasets(0).name(), "my plume");
    EXPECT_EQ(listing.datasets(1).name(), "tiny");
    EXPECT_THAT(listing.datasets(1).frames(), testing::ElementsAre(7, 30));
    EXPECT_THAT(listing.datasets(1).channels(), testing::ElementsAre("density", "heat"));
}

TEST_F(HttpTest, GivesManifestAndFooterAsJson) {
    Manifest manifest;
    ASSERT_TRUE(google::protobuf::util::JsonStringToMessage(get("/v1/datasets/tiny").body, &manifest).ok());
    EXPECT_EQ(manifest.frames_size(), 2);
    EXPECT_EQ(get("/v1/datasets/my%20plume").status, 200);
    FrameFooter footer;
    ASSERT_TRUE(
        google::protobuf::util::JsonStringToMessage(get("/v1/datasets/tiny/frames/7").body, &footer).ok());
    EXPECT_EQ(footer.channels(1).name(), "heat");
}

TEST_F(HttpTest, GivesStoredBytesWithTheirChecksumAsETag) {
    const PageAddress brick = tiny_.bricks(1).at(5);
    const auto page =
        get(fmt::format("/v1/datasets/tiny/frames/7/channels/1/pages/{}/{}", brick.block, brick.node));
    ASSERT_EQ(page.status, 200);
    const auto expected = tiny_.payload(brick);
    EXPECT_EQ(page.body, std::string(reinterpret_cast<const char*>(expected.data()), expected.size()));
    EXPECT_EQ(etagOf(page), fmt::format("\"{:016x}\"", checksum(expected)));
    EXPECT_THAT(page.head, HasSubstr("immutable"));

    const auto block = get("/v1/datasets/tiny/frames/7/channels/0/blocks/0");
    const auto stored = tiny_.store()->readBlock(0, 0);
    EXPECT_EQ(block.body, std::string(reinterpret_cast<const char*>(stored->data()), stored->size()));
}

TEST_F(HttpTest, AnswersNotModifiedToWhoHasThePage) {
    const std::string target = "/v1/datasets/tiny/frames/7/channels/0/blocks/0";
    const std::string etag = etagOf(get(target));
    for (const std::string& tags : {etag, "\"other\", " + etag, "W/" + etag, std::string("*")}) {
        const auto again = get(target, "If-None-Match: " + tags + "\r\n");
        EXPECT_EQ(again.status, 304) << tags;
        EXPECT_EQ(again.body, "");
    }
    EXPECT_EQ(get(target, "If-None-Match: \"other\"\r\n").status, 200);
}

TEST_F(HttpTest, HeadTellsTheLengthAndLeavesTheBodyOut) {
    const std::string target = "/v1/datasets/tiny/frames/7/channels/0/blocks/0";
    const auto full = get(target);
    const auto head = request(server_->port(), "HEAD", target);
    EXPECT_EQ(head.status, 200);
    EXPECT_EQ(head.body, "");
    EXPECT_THAT(head.head + "\r\n", HasSubstr(fmt::format("Content-Length: {}\r\n", full.body.size())));
}

TEST_F(HttpTest, AnswersSeveralRequestsOnOneConnection) {
    RawSocket socket(server_->port());
    // Pipelined: both requests are there before the first answer.
    socket.send("GET /healthz HTTP/1.1\r\nHost: a\r\n\r\nGET /v1/datasets HTTP/1.1\r\nHost: a\r\n\r\n");
    EXPECT_THAT(socket.receiveUntil("my plume"), HasSubstr("ok\n"));
    socket.send("GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n");
    EXPECT_THAT(socket.receiveUntil("ok\n"), HasSubstr("200 OK"));
}

TEST_F(HttpTest, RefusesWhatIsNotThere) {
    for (const char* target :
         {"/", "/v1", "/v2/datasets", "/v1/datasets/none", "/v1/datasets/tiny/frames",
          "/v1/datasets/tiny/frames/8", "/v1/datasets/tiny/frames/7/channels/0",
          "/v1/datasets/tiny/frames/7/channels/2/blocks/0", "/v1/datasets/tiny/frames/7/channels/0/blocks/99",
          "/v1/datasets/tiny/frames/7/channels/0/pages/0/99999",
          "/v1/datasets/tiny/frames/7/channels/0/pages/0/0/0", "/v1/datasets/../tiny",
          "/v1/datasets/..%2f..%2fetc%2fpasswd", "/v1/datasets/%2e%2e", "/v1/datasets//tiny"}) {
        const auto reply = get(target);
        EXPECT_EQ(reply.status, 404) << target;
        EXPECT_EQ(std::count(reply.body.begin(), reply.body.end(), '\n'), 1) << reply.body;
    }
    EXPECT_THAT(get("/v1/datasets/none").body, HasSubstr("tiny"));
}

TEST_F(HttpTest, RefusesWhatIsMalformed) {
    for (const char* target :
         {"/v1/datasets/%zz", "/v1/datasets/%00", "/v1/datasets/tiny/frames/x", "/v1/datasets/tiny/frames/-1",
          "/v1/datasets/tiny/frames/99999999999", "/v1/datasets/tiny/frames/7/channels/0/blocks/0x1",
          "/v1/datasets/tiny/frames/"})
        EXPECT_EQ(get(target).status, 400) << target;
    RawSocket socket(server_->port());
    socket.send("this is not HTTP\r\n\r\n");
    EXPECT_THAT(socket.receiveAll(), HasSubstr("400 Bad Request"));
}

TEST_F(HttpTest, AnswersOnlyGetAndHead) {
    for (const char* method : {"POST", "PUT", "DELETE", "OPTIONS"}) {
        const auto reply = request(server_->port(), method, "/healthz");
        EXPECT_EQ(reply.status, 405) << method;
        EXPECT_THAT(reply.head, HasSubstr("Allow: GET, HEAD"));
    }
}

TEST_F(HttpTest, RefusesHeadersAndBodiesThatAreTooLong) {
    EXPECT_EQ(get("/healthz", "X: " + std::string(20'000, 'x') + "\r\n").status, 431);
    EXPECT_EQ(request(server_->port(), "POST", "/healthz", "Content-Length: 99999999999\r\n").status, 413);
}

TEST_F(HttpTest, AsksForTheTokenEverywhereButForHealth) {
    start({.token = "secret"});
    EXPECT_EQ(get("/healthz").status, 200);
    EXPECT_EQ(get("/v1/datasets").status, 401);
    EXPECT_EQ(get("/v1/datasets/tiny", "Authorization: Bearer secre\r\n").status, 401);
    EXPECT_EQ(get("/v1/datasets/tiny", "Authorization: Bearer secret\r\n").status, 200);
    EXPECT_THAT(get("/v1/datasets").body, Not(HasSubstr("tiny")));
}

TEST_F(HttpTest, TurnsAwayWhoIsOneTooMany) {
    start({.max_connections = 2});
    RawSocket first(server_->port()), second(server_->port());
    for (RawSocket* socket : {&first, &second}) {
        socket->send("GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n");
        EXPECT_THAT(socket->receiveUntil("ok\n"), HasSubstr("200 OK"));
    }
    RawSocket third(server_->port());
    EXPECT_THAT(third.receiveAll(), HasSubstr("503"));
}

TEST_F(HttpTest, DropsWhoSendsNothing) {
    start({.handshake_timeout = std::chrono::milliseconds(200)});
    RawSocket socket(server_->port());
    socket.send("GET /heal");
    EXPECT_TRUE(socket.closes());
}

TEST_F(HttpTest, ServesFramesThatAreAddedMeanwhile) {
    EXPECT_EQ(get("/v1/datasets/my%20plume/frames/7").status, 404);
    // Another conversion ends: here, one dataset takes the other's place, manifest last.
    for (const char* what : {"frames", "manifest.json"})
        std::filesystem::copy(
            tiny_.folder() / what, spaced_.folder() / what,
            std::filesystem::copy_options::recursive | std::filesystem::copy_options::overwrite_existing);
    for (int tries = 0; tries < 100 && get("/v1/datasets/my%20plume/frames/7").status != 200; ++tries)
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
    EXPECT_EQ(get("/v1/datasets/my%20plume/frames/7").status, 200);
}

TEST_F(HttpTest, StopsWhileClientsAreConnected) {
    RawSocket idle(server_->port());
    RawSocket asking(server_->port());
    asking.send("GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n");
    asking.receiveUntil("ok\n");
    const auto begin = std::chrono::steady_clock::now();
    server_->stop();
    EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(2));
    EXPECT_TRUE(asking.closes());
}

TEST(Server, SaysThatThePortIsTaken) {
    const TinyDataset tiny;
    auto first = Server::start(*Catalog::open({tiny.folder()}, 8, 1u << 20), {.port = 0});
    ASSERT_TRUE(first);
    const auto second =
        Server::start(*Catalog::open({tiny.folder()}, 8, 1u << 20), {.port = (*first)->port()});
    ASSERT_FALSE(second);
    EXPECT_THAT(second.error().message, HasSubstr(std::to_string((*first)->port())));
    EXPECT_THAT(second.error().message, HasSubstr("--listen"));
}

TEST(Catalog, RefusesTwoDatasetsOfOneName) {
    const TinyDataset one, two;
    const auto catalog = Catalog::open({one.folder(), two.folder()}, 8, 1u << 20);
    ASSERT_FALSE(catalog);
    EXPECT_EQ(catalog.error().code, ErrorCode::kInvalid);
    EXPECT_THAT(catalog.error().message, HasSubstr(two.folder().string()));
}

TEST(Catalog, NoticesAMissingOrCutFrameAtStart) {
    const TinyDataset tiny("tiny", {.frames = {7, 30}});
    const auto frame = tiny.folder() / Dataset::open(tiny.folder())->manifest().frames(1).file();
    std::filesystem::resize_file(frame, std::filesystem::file_size(frame) - 1);
    EXPECT_EQ(Catalog::open({tiny.folder()}, 8, 1u << 20).error().code, ErrorCode::kCorrupt);
    std::filesystem::remove(frame);
    EXPECT_THAT(Catalog::open({tiny.folder()}, 8, 1u << 20).error().message, HasSubstr(frame.string()));
    EXPECT_EQ(Catalog::open({tiny.folder() / "none"}, 8, 1u << 20).error().code, ErrorCode::kNotFound);
}

TEST(Catalog, TakesTheNameFromTheFolderHoweverItIsWritten) {
    const TinyDataset tiny;
    EXPECT_EQ((*Catalog::open({tiny.folder().string() + "/"}, 8, 1u << 20))->names(),
              std::vector<std::string>{"tiny"});
    EXPECT_EQ((*Catalog::open({tiny.folder() / "." / ".." / "tiny.bricks"}, 8, 1u << 20))->names(),
              std::vector<std::string>{"tiny"});
}

}  // namespace
}  // namespace brickyard
