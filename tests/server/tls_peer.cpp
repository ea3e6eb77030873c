#include "tls_peer.h"

#include <openssl/evp.h>
#include <openssl/pem.h>
#include <openssl/x509.h>

#include <algorithm>
#include <cstdio>
#include <cstdlib>

namespace brickyard {
namespace {

// Test data that cannot be made is no test failure but a broken machine.
void need(bool holds) {
    if (!holds) std::abort();
}

}  // namespace

void writeCertificate(const std::filesystem::path& certificate, const std::filesystem::path& key,
                      long serial) {
    EVP_PKEY* pair = EVP_EC_gen("P-256");
    X509* made = X509_new();
    need(pair != nullptr && made != nullptr);
    X509_set_version(made, 2);
    ASN1_INTEGER_set(X509_get_serialNumber(made), serial);
    X509_gmtime_adj(X509_getm_notBefore(made), -3600);
    X509_gmtime_adj(X509_getm_notAfter(made), 3600);
    X509_set_pubkey(made, pair);
    X509_NAME* name = X509_get_subject_name(made);
    X509_NAME_add_entry_by_txt(name, "CN", MBSTRING_ASC, reinterpret_cast<const unsigned char*>("localhost"),
                               -1, -1, 0);
    X509_set_issuer_name(made, name);
    need(X509_sign(made, pair, EVP_sha256()) > 0);
    std::FILE* out = std::fopen(certificate.c_str(), "w");
    need(out != nullptr && PEM_write_X509(out, made) == 1 && std::fclose(out) == 0);
    out = std::fopen(key.c_str(), "w");
    need(out != nullptr && PEM_write_PrivateKey(out, pair, nullptr, nullptr, 0, nullptr, nullptr) == 1 &&
         std::fclose(out) == 0);
    X509_free(made);
    EVP_PKEY_free(pair);
}

TlsPeer::TlsPeer(std::uint16_t port, int min_version, int max_version, std::size_t max_bytes)
    : socket_(port), left_(max_bytes), context_(SSL_CTX_new(TLS_client_method())) {
    // Level 0, so that it offers what is too old, and the server has something to refuse.
    SSL_CTX_set_security_level(context_, 0);
    need(SSL_CTX_set_cipher_list(context_, "ALL:@SECLEVEL=0") == 1);
    SSL_CTX_set_min_proto_version(context_, min_version);
    SSL_CTX_set_max_proto_version(context_, max_version);
    ssl_ = SSL_new(context_);
    in_ = BIO_new(BIO_s_mem());
    out_ = BIO_new(BIO_s_mem());
    SSL_set_bio(ssl_, in_, out_);
    SSL_set_connect_state(ssl_);
    for (;;) {
        const int done = SSL_do_handshake(ssl_);
        const bool sent = flush();
        if (done == 1) {
            connected_ = sent;
            return;
        }
        if (!sent || SSL_get_error(ssl_, done) != SSL_ERROR_WANT_READ || !feed()) return;
    }
}

TlsPeer::~TlsPeer() {
    SSL_free(ssl_);
    SSL_CTX_free(context_);
}

bool TlsPeer::flush() {
    char buffer[16384];
    for (int got = 0; (got = BIO_read(out_, buffer, sizeof buffer)) > 0;) {
        const std::size_t some = std::min(std::size_t(got), left_);
        left_ -= some;
        sent_ += some;
        if (!socket_.send({buffer, some}) || some < std::size_t(got)) return false;
    }
    return true;
}

bool TlsPeer::feed() {
    const std::string some = socket_.receiveSome();
    BIO_write(in_, some.data(), int(some.size()));
    return !some.empty();
}

long TlsPeer::serial() const {
    X509* shown = SSL_get1_peer_certificate(ssl_);
    if (shown == nullptr) return -1;
    const long serial = ASN1_INTEGER_get(X509_get0_serialNumber(shown));
    X509_free(shown);
    return serial;
}

bool TlsPeer::send(std::string_view bytes) {
    return SSL_write(ssl_, bytes.data(), int(bytes.size())) == int(bytes.size()) && flush();
}

std::string TlsPeer::receiveUntil(std::string_view end) {
    std::string all;
    while (all.find(end) == std::string::npos) {
        char buffer[16384];
        const int got = SSL_read(ssl_, buffer, sizeof buffer);
        if (got > 0)
            all.append(buffer, std::size_t(got));
        else if (SSL_get_error(ssl_, got) != SSL_ERROR_WANT_READ || !feed())
            break;
    }
    return all;
}

}  // namespace brickyard
