// docs/extremes.md: the table that the tests of extremes write and are held to. Each case is a row; a test
// fails where what it measures is another row than the document's. With BRICKYARD_UPDATE_EXTREMES set, the
// rows of this run become the document's instead.
#pragma once

#include <map>
#include <string>

#include "extreme_pictures.h"

namespace brickyard {

struct ExtremeRow {
    std::string name, what, error, bound, verdict;
    std::string text() const;
};

// The largest error of alpha as one of a few classes, so that a last bit changes no document.
std::string errorClass(double worst_alpha);
ExtremeRow rowOf(const std::string& name, const std::string& what, const ExtremeOutcome& outcome);
ExtremeRow refusedRow(const std::string& name, const std::string& what, const std::string& message);

// Expects that nothing is wrong with the outcome, and that the row is the document's. `section`: "Files" or
// "Cases".
void expectRow(const std::string& section, const ExtremeRow& row);
void expectSound(const ExtremeRow& row, const ExtremeOutcome& outcome);

// The document's rows of a section, by name.
std::map<std::string, std::string> documentedRows(const std::string& section);
bool updatesDocument();

}  // namespace brickyard
