// The header of a NRRD file (teem.sourceforge.net/nrrd/format.html), as far as it makes a volume that
// converts. Pure functions, any thread.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/affine.h"
#include "core/field_source.h"
#include "core/result.h"
#include "tools/importers/dense_layout.h"

namespace brickyard {

enum class NrrdEncoding { kRaw, kGzip, kText };

struct NrrdHeader {
    DenseLayout layout;  // its offset is not set: it depends on where the data are
    NrrdEncoding encoding = NrrdEncoding::kRaw;
    std::optional<std::string> data_file;  // as written; absent: the data follow the header
    std::uint64_t line_skip = 0;           // lines in front of the data, as they are stored
    std::int64_t byte_skip = 0;            // then bytes, unpacked; -1 (raw only): the data end the file
    Affine index_to_world;                 // to the header's own space, whichever that is
    std::string vector_type;               // OpenVDB's words; empty for scalars
    std::vector<MetadataEntry> metadata;   // key/value pairs, `content` and `space`
};

// Where the data begin: behind the first empty line. Nothing where `text` has none.
std::optional<std::size_t> findNrrdData(std::string_view text);

// `text`: all lines of the header, from the magic on. Errors: kUnsupported (a kind of NRRD that is no volume
// of ours, with the reason), kTooNew, kInvalid: the field and what is wrong with it.
Result<NrrdHeader> parseNrrdHeader(std::string_view text);

}  // namespace brickyard
