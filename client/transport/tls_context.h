// Certificates and rules of TLS, for a server (which may load them anew) or a client. TLS 1.2 and later. Any
// thread.
#pragma once

#include <boost/asio/ssl/context.hpp>
#include <filesystem>
#include <memory>
#include <string>

#include "core/result.h"

namespace brickyard {

// What one stream needs; keeps living for those that began with it when another one is loaded.
using TlsContext = std::shared_ptr<boost::asio::ssl::context>;

// Certificate chain and key in PEM. Errors: kIo (cannot be read), kInvalid (not a certificate or key, or the
// key is not the certificate's); each names the file.
Result<TlsContext> loadServerTls(const std::filesystem::path& certificate_chain,
                                 const std::filesystem::path& key);

// Believes the certificates of the operating system, or those of `authorities` (PEM) where one is given.
// Errors: kIo, kInvalid.
Result<TlsContext> loadClientTls(const std::filesystem::path& authorities);

}  // namespace brickyard
