#include "extreme_table.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <vector>

namespace brickyard {

namespace {

const char* const kDocument = BRICKYARD_TEST_DATA "/../../docs/extremes.md";
const char* const kColumns = "| case | what it is | alpha is off by at most | bounds | verdict |";

// What is above the table of each section.
const std::pair<const char*, const char*> kSections[] = {
    {"Cases", "Made by `tests/tools/extreme_cases_test.cpp`, through a dataset on disk.\n"},
    {"Files",
     "Every file of the shared folder `data/extremes` (its manifest says how they were made), converted and "
     "drawn by\n"
     "`tests/tools/extreme_files_test.cpp`. \"refused\" is the one line that the command prints.\n"},
};

const char* const kHead =
    R"(# Extremes: what is drawn right, and what is refused

Written by the tests: `BRICKYARD_UPDATE_EXTREMES=1 build/release/tests/extremes_test` makes it anew, and without that
variable the same program fails where a row is no longer true. Each dataset is drawn twice, with a density scale of 1 and
with one that gives its deepest ray an optical depth of 2; each of these in six ways: `--quality reference`, draft, preview
and final, `--max-error 0.05`, and that with `--strict`. Once more it is lit and glows,
and once more it is drawn as whole scenes are (design.md): the reference of that way is within 1e-3 and ends.

- "alpha is off by at most": of `--quality reference`, at the worst pixel, against an integral of the source's samples in
  long double (`tests/client/reference_field.h`), which shares no code with the renderer but the camera's rays. 2e-06 is
  what is promised, and the least class: below it instruction sets differ in their last bits.
- "bounds": `errorBound.A` holds in all twelve pictures, at every pixel.
- In all pictures no value of any layer is negative, infinite or not a number, and each is final within a minute.
)";

using Rows = std::map<std::string, std::string>;

// The rows of this run, by section.
std::map<std::string, Rows>& gathered() {
    static std::map<std::string, Rows> rows;
    return rows;
}

// One line, with what would end a cell replaced.
std::string cell(std::string text) {
    for (char& c : text)
        if (c == '\n' || c == '\r' || c == '\t') c = ' ';
    for (std::size_t at = 0; (at = text.find('|', at)) != std::string::npos; at += 2) text.insert(at, "\\");
    return text;
}

class DocumentWriter final : public testing::Environment {
public:
    void TearDown() override {
        if (!updatesDocument()) return;
        std::ostringstream out;
        out << kHead;
        for (const auto& [name, about] : kSections) {
            // What did not run keeps its row.
            Rows rows = gathered()[name];
            rows.merge(documentedRows(name));
            out << "\n## " << name << "\n\n"
                << about << "\n"
                << kColumns << "\n| --- | --- | --- | --- | --- |\n";
            for (const auto& [row, text] : rows) out << text << "\n";
        }
        std::ofstream(kDocument) << out.str();
    }
};
[[maybe_unused]] const testing::Environment* const kWriter =
    testing::AddGlobalTestEnvironment(new DocumentWriter);

}  // namespace

bool updatesDocument() { return std::getenv("BRICKYARD_UPDATE_EXTREMES") != nullptr; }

std::string ExtremeRow::text() const {
    return fmt::format("| {} | {} | {} | {} | {} |", cell(name), cell(what), error, bound, cell(verdict));
}

std::string errorClass(double worst_alpha) {
    // The least class is what is promised. Below it instruction sets differ in their last bits, and so would
    // the rows.
    for (const double limit : {2e-6, 2e-5, 2e-4, 2e-3, 2e-2, 2e-1})
        if (worst_alpha <= limit) return fmt::format("{:.0e}", limit);
    return "1";
}

ExtremeRow rowOf(const std::string& name, const std::string& what, const ExtremeOutcome& outcome) {
    if (!outcome.refusal.empty()) return refusedRow(name, what, outcome.refusal);
    return {name, what, errorClass(outcome.worst_alpha), outcome.faults.empty() ? "hold" : "BROKEN", "drawn"};
}

ExtremeRow refusedRow(const std::string& name, const std::string& what, const std::string& message) {
    return {name, what, "", "", "refused: " + message};
}

void expectSound(const ExtremeRow& row, const ExtremeOutcome& outcome) {
    EXPECT_LE(outcome.worst_alpha, 2e-6) << row.name;
    for (const std::string& fault : outcome.faults) ADD_FAILURE() << row.name << ": " << fault;
}

void expectRow(const std::string& section, const ExtremeRow& row) {
    gathered()[section][row.name] = row.text();
    if (updatesDocument()) return;
    const Rows documented = documentedRows(section);
    const auto found = documented.find(cell(row.name));
    if (found == documented.end())
        ADD_FAILURE() << "docs/extremes.md has no row for " << row.text();
    else
        EXPECT_EQ(found->second, row.text()) << "docs/extremes.md says otherwise";
}

Rows documentedRows(const std::string& section) {
    std::ifstream in(kDocument);
    Rows rows;
    bool inside = false;
    for (std::string line; std::getline(in, line);) {
        if (line.starts_with("## ")) inside = line == "## " + section;
        if (!inside || !line.starts_with("| ") || line == kColumns || line.starts_with("| ---")) continue;
        rows[line.substr(2, line.find(" | ") - 2)] = line;
    }
    return rows;
}

}  // namespace brickyard
