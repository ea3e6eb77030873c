// The input as a NRRD file: its header must be refused or understood, its data refused or read.
#include <cstdlib>
#include <string>

#include "memory_file.h"
#include "tools/importers/nrrd_header.h"
#include "tools/importers/nrrd_source.h"

using namespace brickyard;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const std::string text(reinterpret_cast<const char*>(data), size);
    const auto header = parseNrrdHeader(text);
    if (!header && header.error().message.find('\n') != std::string::npos) std::abort();
    if (header && !header->layout.bytes()) std::abort();
    const MemoryFile file(text);
    const auto contents = readNrrd(file.path(), {});
    if (!contents) {
        if (contents.error().message.find('\n') != std::string::npos) std::abort();
        return 0;
    }
    SampleBlock block;
    for (const auto& field : contents->fields) (void)field->read({{-1, -1, -1}, {9, 9, 9}}, block);
    return 0;
}
