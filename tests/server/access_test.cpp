// Who may come in, and how: tokens and their scopes, origins, TLS, and all of it read again while the server
// runs.
#include <gmock/gmock.h>

#include "live_server.h"
#include "raw_stream.h"
#include "stored_file.h"
#include "tiny_dataset.h"
#include "tls_peer.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::AnyOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

std::string bearer(const std::string& token) { return "Authorization: Bearer " + token + "\r\n"; }

// Every name of a dataset as "X", so that two answers can be compared.
std::string withoutName(std::string text, const std::string& name) {
    for (std::size_t at = 0; (at = text.find(name, at)) != std::string::npos;)
        text.replace(at, name.size(), "X");
    return text;
}

class TokensTest : public testing::Test {
protected:
    void SetUp() override {
        tokens_.write("all\nnarrow tiny\n");
        ServerOptions options;
        options.token_file = tokens_.path();
        live_ = std::make_unique<LiveServer>(std::vector{tiny_.folder(), secret_.folder()}, options);
    }
    int statusOf(const std::string& target, const std::string& token) {
        return live_->get(target, token.empty() ? "" : bearer(token)).status;
    }

    TinyDataset tiny_, secret_{"secret"};
    StoredFile tokens_{"tokens"};
    std::unique_ptr<LiveServer> live_;
};

TEST_F(TokensTest, HttpAsksForATokenEverywhereButForHealth) {
    EXPECT_EQ(statusOf("/healthz", ""), 200);
    for (const char* target : {"/v1/datasets", "/v1/datasets/tiny", "/v1/datasets/none", "/metrics",
                               "/v1/datasets/tiny/frames/30/channels/0/blocks/0"}) {
        for (const char* wrong : {"", "none", "al", "alll", "ALL", "all tiny", "narrow tiny", "%61ll"})
            EXPECT_EQ(statusOf(target, wrong), 401) << target << " with '" << wrong << "'";
        const auto reply = live_->get(target, "Authorization: Basic YWxsOg==\r\n");
        EXPECT_EQ(reply.status, 401);
        EXPECT_THAT(reply.head, HasSubstr("WWW-Authenticate: Bearer"));
        EXPECT_EQ(live_->get(target, bearer(std::string(5000, 'a'))).status, 401);
    }
    EXPECT_EQ(statusOf("/v1/datasets/secret/frames/30/channels/0/blocks/0", "all"), 200);
    EXPECT_EQ(statusOf("/v1/datasets/tiny/frames/30/channels/0/blocks/0", "narrow"), 200);
}

TEST_F(TokensTest, OverHttpADatasetOutOfScopeLooksLikeOneThatIsNot) {
    // Open, so that nothing but the scope stands before it.
    EXPECT_EQ(statusOf("/v1/datasets/secret/frames/30/channels/0/blocks/0", "all"), 200);
    for (const char* rest : {"", "/", "/frames", "/frames/30", "/frames/31", "/frames/x", "/nothing",
                             "/frames/30/channels/0/blocks/0", "/frames/30/channels/9/blocks/0",
                             "/frames/30/channels/0/pages/0/0", "/frames/30/channels/0/pages/0/0/draft"}) {
        const auto hidden = live_->get(std::string("/v1/datasets/secret") + rest, bearer("narrow"));
        const auto absent = live_->get(std::string("/v1/datasets/absent") + rest, bearer("narrow"));
        EXPECT_EQ(hidden.status, absent.status) << rest;
        EXPECT_EQ(withoutName(hidden.body, "secret"), withoutName(absent.body, "absent")) << rest;
    }
    const auto listing = live_->get("/v1/datasets", bearer("narrow"));
    EXPECT_THAT(listing.body, HasSubstr("\"tiny\""));
    EXPECT_THAT(listing.body, Not(HasSubstr("secret")));
    EXPECT_THAT(live_->get("/v1/datasets", bearer("all")).body, HasSubstr("secret"));
}

TEST_F(TokensTest, OnStreamsADatasetOutOfScopeLooksLikeOneThatIsNot) {
    RawStream stream(live_->port());
    stream.hello(1, "narrow");
    std::string answers[2];
    const std::string names[] = {"secret", "absent"};
    for (int i = 0; i < 2; ++i) {
        stream.send(openMessage(names[i]));
        const auto failed = stream.receive();
        ASSERT_TRUE(failed);
        answers[i] = withoutName(failed->header.ShortDebugString(), names[i]);
    }
    EXPECT_EQ(answers[0], answers[1]);
    EXPECT_THAT(answers[0], HasSubstr("REASON_NO_DATASET"));
    stream.send(openMessage("tiny"));
    EXPECT_TRUE(stream.receive()->header.has_welcome());
}

TEST_F(TokensTest, MetricsNeedATokenForAllDatasets) {
    EXPECT_EQ(statusOf("/metrics", "narrow"), 401);
    EXPECT_EQ(statusOf("/metrics", "all"), 200);
}

TEST_F(TokensTest, ReloadEndsStreamsWhoseTokenIsGoneAndNoOthers) {
    RawStream stays(live_->port()), goes(live_->port()), old(live_->port());
    ASSERT_TRUE(stays.establish("tiny", 1, "all"));
    ASSERT_TRUE(goes.establish("tiny", 1, "narrow"));
    ASSERT_TRUE(old.establish("tiny", 0, "narrow"));
    tokens_.write("all\nother\n");
    ASSERT_TRUE(live_->server().reload());
    for (RawStream* stream : {&goes, &old}) {
        const auto failed = stream->receive();
        ASSERT_TRUE(failed);
        EXPECT_EQ(failed->header.failed().reason(), Failed::REASON_TOKEN);
        EXPECT_FALSE(stream->receive());
        EXPECT_EQ(stream->closeCode(), 1008);
    }
    stays.send(openMessage("secret"));
    const auto welcome = stays.receive();
    EXPECT_TRUE(welcome && welcome->header.has_welcome());
    EXPECT_EQ(statusOf("/v1/datasets", "narrow"), 401);
    EXPECT_EQ(statusOf("/v1/datasets", "other"), 200);
}

TEST_F(TokensTest, ReloadWithANarrowerScopeEndsStreamsThatHaveMoreOpen) {
    RawStream stream(live_->port()), other(live_->port());
    ASSERT_TRUE(stream.establish("secret", 0, "all"));
    stream.send(openFrameMessage(1, 30));
    ASSERT_TRUE(stream.receive()->header.has_frame_opened());
    ASSERT_TRUE(other.establish("tiny", 1, "all"));
    tokens_.write("all tiny\n");
    ASSERT_TRUE(live_->server().reload());
    const auto failed = stream.receive();
    ASSERT_TRUE(failed);
    EXPECT_EQ(failed->header.failed().reason(), Failed::REASON_TOKEN);
    EXPECT_FALSE(stream.receive());
    const auto changed = other.receive();
    ASSERT_TRUE(changed);
    EXPECT_THAT(changed->header.catalog_changed().datasets(), ElementsAre("tiny"));
}

TEST_F(TokensTest, ATokenFileThatCannotBeReadLeavesTheOldTokensInForce) {
    for (const char* text : {"", "# nobody\n", "all tiny%zz\n"}) {
        tokens_.write(text);
        const auto reloaded = live_->server().reload();
        ASSERT_FALSE(reloaded);
        EXPECT_THAT(reloaded.error().message, HasSubstr(tokens_.path().string()));
        EXPECT_EQ(statusOf("/v1/datasets", "all"), 200);
        EXPECT_EQ(statusOf("/v1/datasets", "none"), 401);
    }
    fs::remove(tokens_.path());
    EXPECT_FALSE(live_->server().reload());
    EXPECT_EQ(statusOf("/v1/datasets", ""), 401);
}

TEST(Origins, OnlyTheServersOwnAndThoseAllowedMayOpenAStream) {
    const TinyDataset tiny;
    ServerOptions options;
    options.allowed_origins = {"https://viewer.example", "https://b.example:8443"};
    LiveServer live({tiny.folder()}, options);
    const auto isAccepted = [](const LiveServer& at, const std::string& origin) {
        const RawStream stream(at.port(), 0, origin.empty() ? "" : "Origin: " + origin + "\r\n");
        return stream.answer().starts_with("HTTP/1.1 101 ");
    };
    // The request's Host is localhost.
    for (const char* good : {"", "http://localhost", "https://viewer.example", "https://b.example:8443"})
        EXPECT_TRUE(isAccepted(live, good)) << good;
    for (const char* bad :
         {"null", "http://viewer.example", "https://viewer.example.evil", "https://b.example",
          "http://localhost:1", "https://evil.example", "http://localhost.evil", "*", "evil://"})
        EXPECT_FALSE(isAccepted(live, bad)) << bad;
    options.allowed_origins = {"*"};
    EXPECT_TRUE(isAccepted(LiveServer({tiny.folder()}, options), "https://evil.example"));
}

class TlsTest : public testing::Test {
protected:
    void SetUp() override {
        writeCertificate(certificate(), key(), 1);
        start();
    }
    void start() {
        options_.tls_certificate = certificate();
        options_.tls_key = key();
        options_.port = 0;
        auto server = Server::start(*Catalog::open({tiny_.folder()}, 8, 1u << 20), options_);
        ASSERT_TRUE(server) << server.error().message;
        server_ = std::move(*server);
    }
    fs::path certificate() const { return folder_.path() / "certificate.pem"; }
    fs::path key() const { return folder_.path() / "key.pem"; }
    static bool isHealthy(TlsPeer& peer) {
        return peer.connected() && peer.send("GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n") &&
               peer.receiveUntil("ok\n").starts_with("HTTP/1.1 200 OK");
    }

    StoredFolder folder_;
    TinyDataset tiny_;
    ServerOptions options_;
    std::unique_ptr<Server> server_;
};

TEST_F(TlsTest, SpeaksVersions12And13AndNothingOlder) {
    for (const int version : {TLS1_2_VERSION, TLS1_3_VERSION}) {
        TlsPeer peer(server_->port(), version, version);
        EXPECT_TRUE(isHealthy(peer)) << version;
        EXPECT_EQ(peer.version(), version == TLS1_2_VERSION ? "TLSv1.2" : "TLSv1.3");
    }
    for (const int version : {TLS1_VERSION, TLS1_1_VERSION}) {
        TlsPeer old(server_->port(), version, version);
        EXPECT_FALSE(old.connected()) << version;
    }
}

TEST_F(TlsTest, CarriesTheStream) {
    TlsPeer peer(server_->port());
    ASSERT_TRUE(peer.send(upgradeRequest("/v1/stream")));
    EXPECT_THAT(peer.receiveUntil("\r\n\r\n"), HasSubstr("101 Switching Protocols"));
    StreamHeader hello;
    hello.mutable_hello()->set_protocol_major(1);
    ASSERT_TRUE(peer.send(webSocketFrame(textOf(hello)) + webSocketFrame(textOf(openMessage("none")))));
    EXPECT_THAT(peer.receiveUntil("tiny"), HasSubstr("no dataset 'none' here"));
}

TEST_F(TlsTest, ReloadShowsTheNewCertificateToNewConnectionsAndKeepsTheOldOnes) {
    TlsPeer before(server_->port());
    EXPECT_EQ(before.serial(), 1);
    writeCertificate(certificate(), key(), 2);
    EXPECT_EQ(TlsPeer(server_->port()).serial(), 1) << "before it was told to";
    ASSERT_TRUE(server_->reload());
    TlsPeer after(server_->port());
    EXPECT_EQ(after.serial(), 2);
    EXPECT_TRUE(isHealthy(after));
    EXPECT_TRUE(isHealthy(before));
}

TEST_F(TlsTest, NamesTheFileThatIsWrongAndKeepsWhatItHas) {
    const StoredFile garbage("garbage.pem");
    garbage.write("-----BEGIN CERTIFICATE-----\nnonsense\n-----END CERTIFICATE-----\n");
    const StoredFolder other;
    writeCertificate(other.path() / "certificate.pem", other.path() / "key.pem", 3);
    const fs::path none = folder_.path() / "none.pem";
    struct Case {
        fs::path certificate, key, named;
    };
    const Case cases[] = {{none, key(), none},
                          {certificate(), none, none},
                          {garbage.path(), key(), garbage.path()},
                          {certificate(), garbage.path(), garbage.path()},
                          {certificate(), other.path() / "key.pem", other.path() / "key.pem"},
                          {certificate(), folder_.path(), folder_.path()}};
    for (const Case& wrong : cases) {
        ServerOptions options;
        options.port = 0;
        options.tls_certificate = wrong.certificate;
        options.tls_key = wrong.key;
        const auto server = Server::start(*Catalog::open({tiny_.folder()}, 8, 1u << 20), options);
        ASSERT_FALSE(server) << wrong.named;
        EXPECT_THAT(server.error().message, HasSubstr(wrong.named.string()));
        EXPECT_THAT(server.error().message, Not(HasSubstr("\n")));
    }
    // The same files go bad under a server that runs.
    for (const fs::path& file : {certificate(), key()}) {
        const fs::path kept = folder_.path() / "kept";
        fs::rename(file, kept);
        fs::copy_file(garbage.path(), file);
        const auto reloaded = server_->reload();
        ASSERT_FALSE(reloaded);
        EXPECT_THAT(reloaded.error().message, HasSubstr(file.string()));
        EXPECT_EQ(TlsPeer(server_->port()).serial(), 1);
        fs::rename(kept, file);
    }
    EXPECT_TRUE(server_->reload());
}

TEST_F(TlsTest, DropsWhoSpeaksInTheClearOrNotAtAll) {
    options_.handshake_timeout = milliseconds(400);
    start();
    RawSocket clear(server_->port());
    clear.send("GET /healthz HTTP/1.1\r\nHost: a\r\n\r\n");
    EXPECT_THAT(clear.receiveAll(), Not(HasSubstr("ok")));
    RawSocket silent(server_->port());
    RawSocket half(server_->port());
    half.send(std::string_view("\x16\x03\x01\x01\x00\x01", 6));
    EXPECT_TRUE(silent.closes());
    EXPECT_TRUE(half.closes());
    TlsPeer good(server_->port());
    EXPECT_TRUE(isHealthy(good));
}

TEST_F(TlsTest, SurvivesAConnectionThatIsCutAtAnyByte) {
    const std::string all = upgradeRequest("/v1/stream");
    for (const int version : {TLS1_2_VERSION, TLS1_3_VERSION}) {
        const std::size_t descriptors = openDescriptors();
        std::size_t whole = 0;
        {
            TlsPeer peer(server_->port(), version, version);
            ASSERT_TRUE(peer.send(all));
            whole = peer.sentBytes();
        }
        for (std::size_t cut = 0; cut < whole; cut += 3) {
            // Nothing more is sent than that, and the connection ends; without waiting for what never comes.
            TlsPeer peer(server_->port(), version, version, cut);
            if (peer.connected()) peer.send(all);
            if (cut % 2 == 0) peer.socket().reset();
        }
        TlsPeer good(server_->port());
        EXPECT_TRUE(isHealthy(good));
        EXPECT_TRUE(comesTrue([&] { return openDescriptors() <= descriptors + 2; }));
    }
}

}  // namespace
}  // namespace brickyard
