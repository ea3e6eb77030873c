// Reads one brick's values through the client library: from a dataset folder or from ws://HOST:PORT/NAME.
//     read_brick SOURCE CHANNEL X Y Z
#include <cstdio>
#include <cstdlib>

#include "client/brick_values.h"

int fail(const brickyard::Error& error) {
    std::fprintf(stderr, "read_brick: %s\n", error.message.c_str());
    return 1;
}

int main(int argc, char** argv) {
    if (argc != 6) return std::fprintf(stderr, "usage: read_brick SOURCE CHANNEL X Y Z\n"), 2;
    const std::string name = argv[1], channel = argv[2];
    const std::array<std::int64_t, 3> position{std::atoll(argv[3]), std::atoll(argv[4]), std::atoll(argv[5])};
    const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(20);

    const auto source = brickyard::openSource(name, /*token=*/"");
    if (!source) return fail(source.error());
    const brickyard::Manifest& manifest = (*source)->manifest();
    if (manifest.frames_size() == 0) return fail({brickyard::ErrorCode::kNotFound, name + ": has no frames"});

    const auto footer = (*source)->openFrame(manifest.frames(0).frame(), deadline);
    if (!footer) return fail(footer.error());
    const auto brick = brickyard::readBrick(**source, *footer, channel, position, /*level=*/0, deadline);
    if (!brick) return fail(brick.error());

    // The samples along x from the brick's corner, at the wanted y and z.
    const auto [x, y, z] = brick->origin();
    const std::int64_t step = brick->stepVoxels();
    for (int i = 0; i < brick->shape.edgeSamples(); ++i)
        std::printf("%lld %.9g\n", static_cast<long long>(x + i * step),
                    brick->at(i, int((position[1] - y) / step), int((position[2] - z) / step)));
}
