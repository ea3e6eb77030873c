#include "tools/bench/text_table.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

namespace brickyard {

std::string TextTable::text() const {
    std::vector<std::size_t> widths(rows_[0].size());
    for (const auto& row : rows_)
        for (std::size_t i = 0; i < row.size(); ++i) widths[i] = std::max(widths[i], row[i].size());
    std::string text;
    for (const auto& row : rows_) {
        if (!text.empty()) text += '\n';
        for (std::size_t i = 0; i < row.size(); ++i)
            text += i == 0 ? fmt::format("  {:<{}}", row[i], widths[i])
                           : fmt::format("  {:>{}}", row[i], widths[i]);
    }
    return text;
}

std::string cell(double value) {
    if (!std::isfinite(value)) return "-";
    if (value != 0 && std::abs(value) < 1e-4) return fmt::format("{:.1e}", value);
    return fmt::format("{:.3g}", value);
}

}  // namespace brickyard
