#include "tools/bench/plot.h"

#include <cairo-svg.h>
#include <cairo.h>
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <memory>

#include "tools/bench/plot_axis.h"

namespace brickyard {
namespace {

using Surface = std::unique_ptr<cairo_surface_t, decltype(&cairo_surface_destroy)>;
using Context = std::unique_ptr<cairo_t, decltype(&cairo_destroy)>;

struct Colour {
    double red, green, blue;
};

// Okabe and Ito's palette: told apart by eyes that confuse red and green. Black stays for what is written.
constexpr Colour kPalette[] = {{0.00, 0.45, 0.70}, {0.84, 0.37, 0.00}, {0.00, 0.62, 0.45},
                               {0.80, 0.47, 0.65}, {0.90, 0.62, 0.00}, {0.34, 0.71, 0.91},
                               {0.45, 0.35, 0.25}, {0.45, 0.45, 0.45}};
constexpr Colour kInk{0.13, 0.13, 0.15}, kFaint{0.88, 0.88, 0.90};

constexpr double kTextPoints = 12, kTitlePoints = 13;
constexpr double kLeft = 78, kRight = 16, kTop = 34, kBottom = 48, kLegendLine = 20;

struct Rectangle {
    double x, y, width, height;
};

// A page under the pen. Lengths in points, y downwards.
class Page {
public:
    explicit Page(cairo_t* pen) : pen_(pen) {
        cairo_set_source_rgb(pen_, 1, 1, 1);
        cairo_paint(pen_);
        cairo_set_line_join(pen_, CAIRO_LINE_JOIN_ROUND);
    }

    void line(double x0, double y0, double x1, double y1, const Colour& colour, double width) {
        choose(colour);
        cairo_set_line_width(pen_, width);
        cairo_move_to(pen_, x0, y0);
        cairo_line_to(pen_, x1, y1);
        cairo_stroke(pen_);
    }

    void path(const std::vector<std::pair<double, double>>& points, const Colour& colour) {
        if (points.size() < 2) return;
        choose(colour);
        cairo_set_line_width(pen_, 1.8);
        for (const auto& [x, y] : points) cairo_line_to(pen_, x, y);
        cairo_stroke(pen_);
    }

    void dot(double x, double y, const Colour& colour, bool highlight) {
        choose(colour);
        cairo_arc(pen_, x, y, highlight ? 4.5 : 2.8, 0, 2 * M_PI);
        cairo_fill(pen_);
        if (!highlight) return;
        choose(kInk);
        cairo_set_line_width(pen_, 1.3);
        cairo_arc(pen_, x, y, 6.5, 0, 2 * M_PI);
        cairo_stroke(pen_);
    }

    // `align` 0, 0.5 or 1: the text begins at x, is centred on it, ends there. `y` is its middle.
    void text(double x, double y, const std::string& text, double align, double points = kTextPoints,
              bool bold = false) {
        choose(kInk);
        const double wide = font(text, points, bold);
        cairo_move_to(pen_, x - align * wide, y + 0.36 * points);
        cairo_show_text(pen_, text.c_str());
        cairo_new_path(pen_);
    }

    // Read from below, centred on (x, y).
    void uprightText(double x, double y, const std::string& words) {
        cairo_save(pen_);
        cairo_translate(pen_, x, y);
        cairo_rotate(pen_, -M_PI / 2);
        text(0, 0, words, 0.5);
        cairo_restore(pen_);
    }

    double textWidth(const std::string& words) { return font(words, kTextPoints, false); }

private:
    void choose(const Colour& colour) { cairo_set_source_rgb(pen_, colour.red, colour.green, colour.blue); }

    // Gives the width of `words` in it.
    double font(const std::string& words, double points, bool bold) {
        cairo_select_font_face(pen_, "sans-serif", CAIRO_FONT_SLANT_NORMAL,
                               bold ? CAIRO_FONT_WEIGHT_BOLD : CAIRO_FONT_WEIGHT_NORMAL);
        cairo_set_font_size(pen_, points);
        cairo_text_extents_t extents;
        cairo_text_extents(pen_, words.c_str(), &extents);
        return extents.x_advance;
    }

    cairo_t* pen_;
};

// Every name once, in the order of its first use; its place chooses its colour.
std::vector<std::string> seriesNames(std::span<const PlotPanel> panels) {
    std::vector<std::string> names;
    for (const PlotPanel& panel : panels)
        for (const PlotSeries& series : panel.series)
            if (std::find(names.begin(), names.end(), series.name) == names.end())
                names.push_back(series.name);
    return names;
}

const Colour& colourOf(const std::vector<std::string>& names, const std::string& name) {
    const auto place = std::find(names.begin(), names.end(), name) - names.begin();
    return kPalette[std::size_t(place) % std::size(kPalette)];
}

PlotAxis axisOf(const PlotPanel& panel, bool x_axis) {
    std::vector<double> values;
    for (const PlotSeries& series : panel.series)
        for (const PlotPoint& point : series.points) values.push_back(x_axis ? point.x : point.y);
    return PlotAxis(values, x_axis ? panel.log_x : panel.log_y);
}

void drawFrame(Page& page, const PlotPanel& panel, const Rectangle& box, const PlotAxis& x,
               const PlotAxis& y) {
    double last_end = -1e9;
    for (const PlotAxis::Tick& tick : x.ticks()) {
        const double at = box.x + x.place(tick.value) * box.width, half = 0.5 * page.textWidth(tick.label);
        page.line(at, box.y, at, box.y + box.height, kFaint, tick.label.empty() ? 0.35 : 1);
        // A label that would run into the one before it is left out.
        if (tick.label.empty() || at - half < last_end + 6) continue;
        page.text(at, box.y + box.height + 13, tick.label, 0.5);
        last_end = at + half;
    }
    double last_y = 1e9;
    for (const PlotAxis::Tick& tick : y.ticks()) {
        const double at = box.y + (1 - y.place(tick.value)) * box.height;
        page.line(box.x, at, box.x + box.width, at, kFaint, tick.label.empty() ? 0.35 : 1);
        if (tick.label.empty() || at > last_y - 14) continue;
        page.text(box.x - 7, at, tick.label, 1);
        last_y = at;
    }
    page.line(box.x, box.y + box.height, box.x + box.width, box.y + box.height, kInk, 1);
    page.line(box.x, box.y, box.x, box.y + box.height, kInk, 1);
    page.text(box.x + 0.5 * box.width, box.y - 17, panel.title, 0.5, kTitlePoints, true);
    page.text(box.x + 0.5 * box.width, box.y + box.height + 35, panel.x_label, 0.5);
    page.uprightText(box.x - kLeft + 13, box.y + 0.5 * box.height, panel.y_label);
}

void drawPanel(Page& page, const PlotPanel& panel, const Rectangle& box,
               const std::vector<std::string>& names) {
    const PlotAxis x = axisOf(panel, true), y = axisOf(panel, false);
    drawFrame(page, panel, box, x, y);
    const auto place = [&](const PlotPoint& point) {
        return std::pair(box.x + x.place(point.x) * box.width, box.y + (1 - y.place(point.y)) * box.height);
    };
    const auto shown = [&](const PlotPoint& point) { return x.shows(point.x) && y.shows(point.y); };
    for (const PlotSeries& series : panel.series) {
        std::vector<std::pair<double, double>> joined;
        for (const PlotPoint& point : series.points)
            if (series.line && shown(point)) joined.push_back(place(point));
        page.path(joined, colourOf(names, series.name));
    }
    // Marks and words lie above every line.
    for (const PlotSeries& series : panel.series)
        for (const PlotPoint& point : series.points) {
            if (!shown(point)) continue;
            const auto [at_x, at_y] = place(point);
            if (series.markers || point.highlight)
                page.dot(at_x, at_y, colourOf(names, series.name), point.highlight);
            const bool near_right = at_x + 12 + page.textWidth(point.label) > box.x + box.width + kRight;
            if (!point.label.empty())
                page.text(near_right ? at_x - 10 : at_x + 10, at_y - 8, point.label, near_right ? 1 : 0);
        }
}

// Draws nothing where `page` is null. Gives the legend's height: lines are filled from the left and broken at
// `width`.
double drawLegend(Page& measure, Page* page, double top, double width,
                  const std::vector<std::string>& names) {
    double x = kLeft, y = top + 0.5 * kLegendLine;
    for (const std::string& name : names) {
        const double wide = 24 + measure.textWidth(name) + 18;
        if (x > kLeft && x + wide > width) {
            x = kLeft;
            y += kLegendLine;
        }
        if (page) {
            page->line(x, y, x + 18, y, colourOf(names, name), 1.8);
            page->dot(x + 9, y, colourOf(names, name), false);
            page->text(x + 24, y, name, 0);
        }
        x += wide;
    }
    return y + 0.5 * kLegendLine - top;
}

struct Layout {
    double width, height, panel_width, panel_height;
};

Layout layOut(std::span<const PlotPanel> panels, double width, const std::vector<std::string>& names) {
    const Surface blank(cairo_image_surface_create(CAIRO_FORMAT_A8, 1, 1), cairo_surface_destroy);
    const Context pen(cairo_create(blank.get()), cairo_destroy);
    Page page(pen.get());
    Layout layout{};
    layout.width = width;
    layout.panel_width = width / double(std::max<std::size_t>(panels.size(), 1));
    layout.panel_height = std::min(420.0, std::max(260.0, 0.85 * layout.panel_width));
    layout.height = layout.panel_height + drawLegend(page, nullptr, 0, width, names) + 10;
    return layout;
}

void drawAll(cairo_t* pen, std::span<const PlotPanel> panels, const Layout& layout,
             const std::vector<std::string>& names) {
    Page page(pen);
    for (std::size_t i = 0; i < panels.size(); ++i)
        drawPanel(page, panels[i],
                  {double(i) * layout.panel_width + kLeft, kTop, layout.panel_width - kLeft - kRight,
                   layout.panel_height - kTop - kBottom},
                  names);
    drawLegend(page, &page, layout.panel_height, layout.width, names);
}

Result<void> checkStatus(cairo_status_t status, const std::string& file) {
    if (status == CAIRO_STATUS_SUCCESS) return {};
    return fail(ErrorCode::kIo, fmt::format("{}: cannot be written ({}); choose another folder", file,
                                            cairo_status_to_string(status)));
}

}  // namespace

Result<void> writePlot(std::span<const PlotPanel> panels, const std::filesystem::path& file, double width) {
    const std::vector<std::string> names = seriesNames(panels);
    const Layout layout = layOut(panels, width, names);

    const std::string svg_file = file.string() + ".svg";
    const Surface svg(cairo_svg_surface_create(svg_file.c_str(), layout.width, layout.height),
                      cairo_surface_destroy);
    drawAll(Context(cairo_create(svg.get()), cairo_destroy).get(), panels, layout, names);
    cairo_surface_finish(svg.get());
    if (Result<void> done = checkStatus(cairo_surface_status(svg.get()), svg_file); !done) return done;

    const std::string png_file = file.string() + ".png";
    constexpr double kPixelsPerPoint = 2;
    const Surface png(
        cairo_image_surface_create(CAIRO_FORMAT_RGB24, int(std::ceil(layout.width * kPixelsPerPoint)),
                                   int(std::ceil(layout.height * kPixelsPerPoint))),
        cairo_surface_destroy);
    const Context pen(cairo_create(png.get()), cairo_destroy);
    cairo_scale(pen.get(), kPixelsPerPoint, kPixelsPerPoint);
    drawAll(pen.get(), panels, layout, names);
    return checkStatus(cairo_surface_write_to_png(png.get(), png_file.c_str()), png_file);
}

}  // namespace brickyard
