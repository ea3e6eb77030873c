// A fuzz target without libFuzzer: as many inputs as are asked for, from the target's own mutator and a fixed
// seed, so that every build of the tests runs it, with any compiler.
//   NAME_replay [EXECUTIONS]
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <vector>

#include "stream_messages.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);
extern "C" std::size_t LLVMFuzzerCustomMutator(std::uint8_t* data, std::size_t size, std::size_t max_size,
                                               unsigned seed);

namespace {

constexpr std::size_t kMaxBytes = 4096, kInputs = 512;
brickyard::Dice dice(20261126);

}  // namespace

// libFuzzer's name for one change that knows nothing of the input: here bytes that are flipped, cut,
// repeated or put in.
extern "C" std::size_t LLVMFuzzerMutate(std::uint8_t* data, std::size_t size, std::size_t max_size) {
    const std::uint32_t at = size == 0 ? 0 : dice.below(std::uint32_t(size));
    const std::size_t room = max_size - size;
    switch (dice.below(5)) {
        case 0: return size == 0 ? size : at;
        case 1: {
            const std::size_t count = std::min<std::size_t>({size - at, room, 1 + dice.below(16)});
            std::memmove(data + at + count, data + at, size - at);
            return size + count;
        }
        case 2: {
            const std::size_t count = std::min<std::size_t>(room, 1 + dice.below(4));
            for (std::size_t i = 0; i < count; ++i) data[size + i] = std::uint8_t(dice.next());
            return size + count;
        }
        case 3:
            if (size > 0) data[at] = std::uint8_t(dice.once(2) ? 0xff : 0);
            return size;
        default:
            if (size > 0) data[at] ^= std::uint8_t(1u << dice.below(8));
            return size;
    }
}

int main(int argc, char** argv) {
    const long executions = argc > 1 ? std::atol(argv[1]) : 20'000;
    // Each input comes from an earlier one, so that changes add up; now and then one begins anew.
    std::vector<std::vector<std::uint8_t>> inputs(kInputs);
    for (long i = 0; i < executions; ++i) {
        auto input = inputs[dice.below(kInputs)];
        if (dice.once(64)) input.clear();
        const std::size_t size = input.size();
        input.resize(kMaxBytes);
        input.resize(LLVMFuzzerCustomMutator(input.data(), size, kMaxBytes, unsigned(dice.next())));
        LLVMFuzzerTestOneInput(input.data(), input.size());
        inputs[dice.below(kInputs)] = std::move(input);
    }
    std::printf("%ld executions\n", executions);
    return 0;
}
