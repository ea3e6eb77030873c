// Every file of the shared folder of extremes: converted, drawn, held against its own samples; or refused in
// one line.
#include <gmock/gmock.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <iostream>

#include "core/finite_field.h"
#include "extreme_table.h"
#include "frame_fixture.h"
#include "tools/conversion.h"
#include "tools/importers/openvdb_source.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;

const fs::path kFolder = fs::path(BRICKYARD_TEST_DATA) / "../../../shared/data/extremes";
// Some files have hundreds of channels; the first few stand for all.
constexpr int kMostChannels = 4;
// 6.9e10 voxels in 19 kB take the converter minutes. BRICKYARD_SLOW_EXTREMES takes it along; else its row
// stays.
constexpr const char* kSlowFile = "tiles_only_all_levels.vdb";

// Largest floats of both signs in one cell: the digits of what is left between them are lost in any
// arithmetic, double or long double. The bound must say so, and does; no alpha is right or wrong.
constexpr const char* kLostDigits = "nan_inf.vdb --nonfinite clamp";

// The manifest's words on each file.
std::map<std::string, std::string> describedFiles() {
    std::map<std::string, std::string> words;
    std::ifstream in(kFolder / "../manifest.md");
    bool inside = false;
    for (std::string line; std::getline(in, line);) {
        if (line.starts_with("## ")) inside = line == "## extremes";
        if (!inside || !line.starts_with("| ")) continue;
        const std::size_t name = line.find(" | "), size = line.find(" | ", name + 3),
                          what = line.find(" | ", size + 3);
        if (what == std::string::npos) continue;
        words[line.substr(2, name - 2)] = line.substr(size + 3, what - size - 3);
    }
    return words;
}

std::string without(std::string text, const std::string& folder) {
    for (std::size_t at = 0; (at = text.find(folder)) != std::string::npos;) text.erase(at, folder.size());
    return text;
}

class ExtremeFiles : public testing::Test {
protected:
    void SetUp() override {
        if (!fs::is_directory(kFolder)) GTEST_SKIP() << kFolder << " is not there";
    }
    Result<ConversionReport> convertFile(const fs::path& file, NonFinite policy) const {
        ConversionOptions options;
        options.inputs = {file.string()};
        options.output = scratch_ / "out.bricks";
        options.nonfinite = policy;
        options.existing = ExistingDataset::kOverwrite;
        options.probe_program = BRICKYARD_COMMAND;
        return convert(options);
    }
    // All scalar channels, as one outcome.
    ExtremeOutcome drawChannels(const fs::path& file, NonFinite policy, std::uint32_t frame,
                                int& drawn) const {
        ExtremeOutcome all;
        const auto contents = readVdb(file, {});
        EXPECT_TRUE(contents);
        if (!contents) return all;
        for (const auto& field : contents->fields) {
            if (field->info().components != 1 || drawn == kMostChannels) continue;
            const auto finite = FiniteField::create(*field, policy);
            EXPECT_TRUE(finite);
            ExtremeView view;
            view.dataset = (scratch_ / "out.bricks").string();
            view.frame = frame;
            const ExtremeOutcome one = drawExtreme(*finite, view);
            ++drawn;
            all.worst_alpha = std::max(all.worst_alpha, one.worst_alpha);
            if (!one.refusal.empty()) all.refusal = one.refusal;
            all.faults.insert(all.faults.end(), one.faults.begin(), one.faults.end());
        }
        return all;
    }
    void expectFile(const fs::path& file, const std::string& what, NonFinite policy) {
        const std::string name =
            file.filename().string() + (policy == NonFinite::kClamp ? " --nonfinite clamp" : "");
        const auto report = convertFile(file, policy);
        if (!report) {
            const std::string message = without(without(report.error().message, kFolder.string() + "/"),
                                                scratch_.path().string() + "/");
            EXPECT_EQ(message.find('\n'), std::string::npos) << name << ": " << message;
            expectRow("Files", refusedRow(name, what, message));
            // What is refused for its values may be had with other ones.
            if (policy == NonFinite::kReject && message.find("--nonfinite") != std::string::npos)
                expectFile(file, what, NonFinite::kClamp);
            return;
        }
        int drawn = 0;
        const ExtremeOutcome outcome = drawChannels(file, policy, report->frames.at(0).frame(), drawn);
        ExtremeRow row = rowOf(name, what, outcome);
        if (drawn == 0) row = {name, what, "", "", "converted; has no scalar channel to draw"};
        if (outcome.refusal.empty() && name != kLostDigits) expectSound(row, outcome);
        if (name == kLostDigits) EXPECT_THAT(outcome.faults, testing::IsEmpty());
        expectRow("Files", row);
    }

    ScratchFolder scratch_;
};

TEST_F(ExtremeFiles, EachIsDrawnRightOrRefusedInOneLine) {
    const auto described = describedFiles();
    std::vector<fs::path> files;
    for (const auto& entry : fs::directory_iterator(kFolder)) files.push_back(entry.path());
    std::sort(files.begin(), files.end());
    ASSERT_GT(files.size(), 100u);
    for (const fs::path& file : files) {
        if (file.filename() == kSlowFile && !std::getenv("BRICKYARD_SLOW_EXTREMES")) continue;
        const auto what = described.find(file.filename().string());
        expectFile(file, what == described.end() ? "" : what->second, NonFinite::kReject);
    }
}

TEST_F(ExtremeFiles, TheTableHasNoRowOfAFileThatIsNotThere) {
    if (updatesDocument()) return;
    for (const auto& [name, row] : documentedRows("Files"))
        EXPECT_TRUE(fs::exists(kFolder / name.substr(0, name.find(" --")))) << row;
}

}  // namespace
}  // namespace brickyard
