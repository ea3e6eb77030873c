// The manifest of a dataset that several processes, on several machines, add to: replaced as a whole, and
// only by who has seen the newest. No lock is needed for that: each manifest has a number, and a number is
// claimed by link(2), which only one can win. Why so: docs/decisions/0006-farm-commits.md.
#pragma once

#include <filesystem>

#include "core/result.h"
#include "proto/dataset.pb.h"

namespace brickyard {

inline constexpr const char* kTemporaryPrefix = ".tmp-";
inline constexpr const char* kClaimPrefix = ".claim-";

// A rename is only as durable as the folder that records it.
Result<void> syncFolder(const std::filesystem::path& folder);

// The newest manifest of the folder, also one whose writer died before all could see it: that is made
// visible. Errors: those of Dataset::open.
Result<Manifest> readNewestManifest(const std::filesystem::path& folder);

// Makes `next` the manifest if its number (generation) is the first that nobody has claimed; else false: read
// the newest and try again. Errors: kIo. Whatever happens, a manifest that was claimed stays.
Result<bool> commitManifest(const std::filesystem::path& folder, const Manifest& next);

}  // namespace brickyard
