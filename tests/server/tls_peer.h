// The other side of TLS, without Boost: certificates that nobody signed, and a client that says what it got.
#pragma once

#include <openssl/ssl.h>

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

#include "raw_socket.h"

namespace brickyard {

// A self-signed certificate for "localhost" with this serial number, and its key, as PEM.
void writeCertificate(const std::filesystem::path& certificate, const std::filesystem::path& key,
                      long serial);

class TlsPeer {
public:
    // Connects; the handshake is done, or failed, when this returns. Believes any certificate. `max_bytes`:
    // after so many of what it sends, nothing more is sent, the handshake's included.
    explicit TlsPeer(std::uint16_t port, int min_version = TLS1_2_VERSION, int max_version = TLS1_3_VERSION,
                     std::size_t max_bytes = SIZE_MAX);
    ~TlsPeer();
    TlsPeer(const TlsPeer&) = delete;
    TlsPeer& operator=(const TlsPeer&) = delete;

    bool connected() const { return connected_; }
    std::string version() const { return SSL_get_version(ssl_); }
    // Of the certificate that the server showed.
    long serial() const;

    bool send(std::string_view bytes);
    // Until `end` has come, or nothing comes.
    std::string receiveUntil(std::string_view end);
    RawSocket& socket() { return socket_; }
    std::size_t sentBytes() const { return sent_; }

private:
    // Moves bytes between OpenSSL and the socket; false where the socket gives none.
    bool flush();
    bool feed();

    RawSocket socket_;
    std::size_t left_, sent_ = 0;
    SSL_CTX* context_ = nullptr;
    SSL* ssl_ = nullptr;
    BIO *in_ = nullptr, *out_ = nullptr;  // owned by ssl_
    bool connected_ = false;
};

}  // namespace brickyard
