#include "transport/tls_context.h"

#include <fmt/format.h>
#include <openssl/ssl.h>

#include <fstream>

namespace brickyard {
namespace {

namespace ssl = boost::asio::ssl;
using ErrorCondition = boost::system::error_code;

TlsContext makeContext(ssl::context::method method) {
    auto context = std::make_shared<ssl::context>(method);
    SSL_CTX_set_min_proto_version(context->native_handle(), TLS1_2_VERSION);
    // A peer could make us work by renegotiating over and over (CVE-2011-1473); compression leaks (CRIME).
    SSL_CTX_set_options(context->native_handle(), SSL_OP_NO_RENEGOTIATION | SSL_OP_NO_COMPRESSION);
    // A connection that waits keeps no record buffers: 34 KiB less for each of ten thousand.
    SSL_CTX_set_mode(context->native_handle(), SSL_MODE_RELEASE_BUFFERS);
    return context;
}

Result<void> checkReadable(const std::filesystem::path& file) {
    std::error_code error;
    if (std::filesystem::is_regular_file(file, error) && std::ifstream(file)) return {};
    return fail(ErrorCode::kIo, fmt::format("{}: cannot be read; give a PEM file", file.string()));
}

}  // namespace

Result<TlsContext> loadServerTls(const std::filesystem::path& certificate_chain,
                                 const std::filesystem::path& key) {
    for (const auto& file : {certificate_chain, key})
        if (auto readable = checkReadable(file); !readable) return tl::unexpected(readable.error());
    auto context = makeContext(ssl::context::tls_server);
    // Only suites with forward secrecy; what TLS 1.3 has is sound without us.
    SSL_CTX_set_cipher_list(context->native_handle(), "ECDHE+AESGCM:ECDHE+CHACHA20:!aNULL");
    SSL_CTX_set_options(context->native_handle(), SSL_OP_CIPHER_SERVER_PREFERENCE);
    ErrorCondition error;
    context->use_certificate_chain_file(certificate_chain.string(), error);
    if (error)
        return fail(ErrorCode::kInvalid, fmt::format("{}: is no certificate chain in PEM ({})",
                                                     certificate_chain.string(), error.message()));
    context->use_private_key_file(key.string(), ssl::context::pem, error);
    if (error)
        return fail(ErrorCode::kInvalid,
                    fmt::format("{}: is no private key in PEM for the certificate in {} ({})", key.string(),
                                certificate_chain.string(), error.message()));
    return context;
}

Result<TlsContext> loadClientTls(const std::filesystem::path& authorities) {
    auto context = makeContext(ssl::context::tls_client);
    context->set_verify_mode(ssl::verify_peer);
    ErrorCondition error;
    if (authorities.empty()) {
        context->set_default_verify_paths(error);
        if (error)
            return fail(
                ErrorCode::kIo,
                fmt::format("the certificate authorities of this machine cannot be read ({}); install "
                            "ca-certificates, or name a PEM file",
                            error.message()));
        return context;
    }
    if (auto readable = checkReadable(authorities); !readable) return tl::unexpected(readable.error());
    context->load_verify_file(authorities.string(), error);
    if (error)
        return fail(ErrorCode::kInvalid, fmt::format("{}: holds no certificate in PEM ({})",
                                                     authorities.string(), error.message()));
    return context;
}

}  // namespace brickyard
