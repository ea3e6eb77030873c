// The input as a layout behind --raw: what is accepted must have a size, and must read within it.
#include <cstdlib>
#include <string>

#include "memory_file.h"
#include "tools/importers/input_file.h"
#include "tools/importers/raw_layout.h"

using namespace brickyard;

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
    const std::string text(reinterpret_cast<const char*>(data), size);
    const auto layout = parseRawLayout(text);
    if (!layout) {
        if (layout.error().message.find('\n') != std::string::npos) std::abort();
        return 0;
    }
    const auto bytes = layout->dense.bytes();
    if (!bytes) std::abort();
    const std::uint64_t whole = layout->dense.offset + *bytes + layout->trailing_bytes;
    if (whole > 4096 || text.empty()) return 0;
    const std::string content(std::size_t(whole), '\x35');
    const MemoryFile file(content);
    InputOptions options;
    options.raw = text;
    const auto contents = openInput(file.path(), options);
    if (!contents) std::abort();
    SampleBlock block;
    if (!contents->fields[0]->read({{-1, -1, -1}, {5, 5, 5}}, block)) std::abort();
    return 0;
}
