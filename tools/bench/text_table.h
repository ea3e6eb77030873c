// Rows of words under a header, as text in columns: the first to the left, the others to the right. Plain
// value.
#pragma once

#include <string>
#include <vector>

namespace brickyard {

class TextTable {
public:
    explicit TextTable(std::vector<std::string> header) : rows_{std::move(header)} {}
    // As many cells as the header has.
    void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
    // Without a newline at the end.
    std::string text() const;

private:
    std::vector<std::vector<std::string>> rows_;
};

// Short enough for a column: "0.00123", "1.23e-06", "12.3"; "-" for what is not a number.
std::string cell(double value);

}  // namespace brickyard
