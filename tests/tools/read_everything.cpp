#include "read_everything.h"

#include <functional>

namespace brickyard {

std::vector<Error> readEverything(const InputContents& contents, int most_boxes) {
    std::vector<Error> errors;
    for (const auto& field : contents.fields) {
        int boxes = 0;
        const std::function<void(const IndexBox&)> descend = [&](const IndexBox& box) {
            if (boxes >= most_boxes || field->uniformOver(box)) return;
            if (box.extent(0) <= 32) {
                ++boxes;
                SampleBlock block;
                if (auto read = field->read(box, block); !read) errors.push_back(read.error());
                return;
            }
            const std::int64_t half = box.extent(0) / 2;
            for (int octant = 0; octant < 8; ++octant) {
                IndexBox part = box;
                for (std::size_t a = 0; a < 3; ++a) {
                    const bool upper = octant >> a & 1;
                    (upper ? part.begin : part.end)[a] += upper ? half : -half;
                }
                descend(part);
            }
        };
        constexpr std::int64_t kHalf = std::int64_t(1) << 31;
        descend({{-kHalf, -kHalf, -kHalf}, {kHalf, kHalf, kHalf}});
        field->release();
        (void)field->info().active_voxels;
    }
    return errors;
}

}  // namespace brickyard
