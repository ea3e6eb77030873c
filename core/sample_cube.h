// A cube (or box) of samples inside a larger array, x fastest. A view; plain value.
#pragma once

#include <cstddef>

namespace brickyard {

template <class T>
struct SampleCube {
    const T* first = nullptr;
    std::size_t row = 0, plane = 0;  // samples from one row, and one plane, to the next

    const T* rowAt(std::size_t j, std::size_t k) const { return first + k * plane + j * row; }
    T at(std::size_t i, std::size_t j, std::size_t k) const { return rowAt(j, k)[i]; }
    SampleCube from(std::size_t i, std::size_t j, std::size_t k) const {
        return {rowAt(j, k) + i, row, plane};
    }
};

// A cube of its own: `edge`^3 samples behind each other.
template <class T>
SampleCube<T> wholeCube(const T* samples, std::size_t edge) {
    return {samples, edge, edge * edge};
}

}  // namespace brickyard
