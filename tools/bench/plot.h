// Charts for a page: panels side by side over one legend, as SVG and as PNG, drawn by the same code.
#pragma once

#include <array>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"

namespace brickyard {

struct PlotPoint {
    double x = 0, y = 0;
    std::string label;       // written beside the point; may be empty
    bool highlight = false;  // drawn larger, with a ring
};

// Series of one name have one colour and one entry in the legend, over all panels.
struct PlotSeries {
    std::string name;
    std::vector<PlotPoint> points;  // a line joins them in this order
    bool line = true;
    bool markers = true;
};

struct PlotPanel {
    std::string title, x_label, y_label;
    bool log_x = false, log_y = false;  // a point that has no logarithm is left out
    std::vector<PlotSeries> series;
};

// Writes `file` with the extensions .svg and .png: `width` points wide, the PNG at two pixels a point. Panels
// share the width. Errors: kIo (the file cannot be written).
Result<void> writePlot(std::span<const PlotPanel> panels, const std::filesystem::path& file,
                       double width = 880);

}  // namespace brickyard
