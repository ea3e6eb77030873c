// NRRD files through the importer and the command; what is expected is read from their bytes here.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <glm/geometric.hpp>

#include "command_run.h"
#include "raw_file.h"
#include "tools/importers/input_file.h"
#include "tools/importers/nrrd_header.h"

namespace brickyard {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

std::string header(const std::string& fields) { return "NRRD0005\n# a comment\n" + fields + "\n"; }

const std::string kSmall = "type: uint8\ndimension: 3\nsizes: 2 3 4\nencoding: raw\n";

class NrrdInput : public testing::Test {
protected:
    Outcome brickyard(const std::vector<std::string>& arguments) {
        return runCommand(logs_.path(), arguments);
    }
    std::string path(const std::string& name) const { return (scratch_ / name).string(); }
    std::string write(const std::string& name, const std::string& bytes) const {
        writeFile(scratch_ / name, bytes);
        return path(name);
    }
    InputContents open(const std::string& bytes, const std::string& name = "a.nrrd") {
        auto contents = openInput(write(name, bytes), {});
        EXPECT_TRUE(contents) << contents.error().message;
        if (!contents) return {};
        EXPECT_EQ(contents->fields.size(), 1u);
        return std::move(*contents);
    }
    void refuse(const std::string& bytes, const std::string& why) {
        const auto contents = openInput(write("bad.nrrd", bytes), {});
        ASSERT_FALSE(contents) << "accepted, instead of: " << why;
        EXPECT_THAT(contents.error().message, HasSubstr("bad.nrrd"));
        EXPECT_THAT(contents.error().message, HasSubstr(why));
        EXPECT_EQ(contents.error().message.find('\n'), std::string::npos);
    }
    glm::dvec3 place(const std::string& fields, const glm::dvec3& index) {
        const auto contents = open(header(kSmall + fields) + std::string(24, 'x'));
        return contents.fields.empty() ? glm::dvec3(0)
                                       : contents.fields[0]->info().index_to_world.point(index);
    }
    ScratchFolder scratch_, logs_;
};

TEST_F(NrrdInput, EveryTypeEndianAndEncodingIsRead) {
    unsigned seed = 100;
    for (const auto& [type, name] : {std::pair("uint8", "unsigned char"),
                                     {"int8", "signed char"},
                                     {"uint16", "ushort"},
                                     {"int16", "short int"},
                                     {"uint32", "unsigned int"},
                                     {"int32", "int32_t"},
                                     {"uint64", "unsigned long long"},
                                     {"int64", "longlong"},
                                     {"float32", "float"},
                                     {"float64", "double"}})
        for (const bool big : {false, true})
            for (const bool packed : {false, true}) {
                const RawFile raw = randomRaw(9, 14, 11, type, false, big, ++seed);
                const std::string fields =
                    std::string("type: ") + name +
                    "\nDimension: 3\nsizes: 9 14 11\nendian: " + (big ? "big" : "little") +
                    "\nencoding: " + (packed ? "GZIP" : "raw") + "\n";
                const auto contents = open(header(fields) + (packed ? gzipped(raw.bytes) : raw.bytes));
                if (!contents.fields.empty())
                    expectValues(*contents.fields[0], raw, {{-1, -1, -1}, {10, 15, 12}});
            }
}

TEST_F(NrrdInput, TextIsRead) {
    const auto contents = open(header("type: short\ndimension: 3\nsizes: 2 2 2\nencoding: ascii\n") +
                               "1 -2,3\n\t+4 5 6\r\n-32768 32767 \n");
    ASSERT_EQ(contents.fields.size(), 1u);
    SampleBlock block;
    ASSERT_TRUE(contents.fields[0]->read({{0, 0, 0}, {2, 2, 2}}, block));
    std::array<std::int32_t, 8> values;
    std::memcpy(values.data(), block.values.data(), sizeof values);
    EXPECT_THAT(values, testing::ElementsAre(1, -2, 3, 4, 5, 6, -32768, 32767));
    const std::string start = header("type: short\ndimension: 3\nsizes: 2 2 2\nencoding: ascii\n");
    refuse(start + "1 2 3", "cannot hold 8");
    refuse(start + "1 2 3 4 5 6 7       ", "has 7 numbers");
    refuse(start + "1 2 3 4 5 6 7 8 9", "more than 8");
    refuse(start + "1 2 3 4 5 6 7 32768", "number 8");
    refuse(start + "1 2 3 4 x 6 7 8    ", "'x'");
    refuse(start + std::string(100'000, '7'), "number 1");
}

TEST_F(NrrdInput, HeadersOfSeveralKindsMeanTheirPlaces) {
    // Directions and origin: the origin is the centre of the first sample, whatever the centering.
    const std::string directed =
        "space: left-posterior-superior\nspace directions: (0,2,0) (-3,0,0) (0,0.5,4)\nspace origin: "
        "(10,20,-30)\n";
    for (const char* centers : {"", "centers: cell cell cell\n", "centerings: node node node\n"}) {
        EXPECT_EQ(place(directed + centers, {0, 0, 0}), glm::dvec3(10, 20, -30));
        EXPECT_EQ(place(directed + centers, {1, 2, 3}), glm::dvec3(4, 23.5, -18));
    }
    EXPECT_EQ(place("", {1, 2, 3}), glm::dvec3(1, 2, 3));
    EXPECT_EQ(place("spacings: 0.5 2 NaN\n", {1, 1, 1}), glm::dvec3(0.5, 2, 1));
    // Cells lie between their axis' ends, nodes on them.
    const std::string ends = "axis mins: 10 20 30\naxismaxs: 11 23 34\n";
    EXPECT_EQ(place(ends, {0, 0, 0}), glm::dvec3(10.25, 20.5, 30.5));
    EXPECT_EQ(place(ends + "centers: cell cell cell\n", {1, 1, 1}), glm::dvec3(10.75, 21.5, 31.5));
    EXPECT_EQ(place(ends + "centers: node node node\n", {1, 2, 3}), glm::dvec3(11, 23, 34));
}

TEST_F(NrrdInput, VectorsOnTheFirstOrLastAxisBecomeComponents) {
    for (const bool first : {true, false}) {
        const std::string fields =
            std::string("type: float\nendian: little\ndimension: 4\nencoding: raw\nsizes: ") +
            (first ? "3 2 2 2\nkinds: vector domain domain domain\nspace directions: none (1,0,0) (0,1,0) "
                     "(0,0,1)\n"
                   : "2 2 2 3\nkinds: space space space covariant-vector\n") +
            "space origin: (0,0,0)\n";
        std::array<float, 24> stored;
        for (std::size_t i = 0; i < 24; ++i) stored[i] = float(i);
        const auto contents =
            open(header(fields) + std::string(reinterpret_cast<const char*>(stored.data()), sizeof stored));
        ASSERT_EQ(contents.fields.size(), 1u);
        const ChannelInfo& info = contents.fields[0]->info();
        EXPECT_EQ(info.components, 3);
        EXPECT_EQ(info.background.size(), 3u);
        EXPECT_EQ(info.vector_type, first ? "invariant" : "covariant");
        SampleBlock block;
        ASSERT_TRUE(contents.fields[0]->read({{0, 0, 0}, {2, 2, 2}}, block));
        std::array<float, 24> values;
        std::memcpy(values.data(), block.values.data(), sizeof values);
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t i = 0; i < 8; ++i)
                EXPECT_EQ(values[c * 8 + i], float(first ? i * 3 + c : c * 8 + i));
        const std::string file = path("a.nrrd"), out = path(first ? "f.bricks" : "l.bricks");
        ASSERT_EQ(brickyard({"convert", file, out}).status, 0);
        EXPECT_EQ(brickyard({"verify", out, "--against", file}).status, 0);
    }
}

TEST_F(NrrdInput, KeysBecomeMetadata) {
    const auto contents =
        open(header(kSmall +
                    "content: a head\nmodality:=MR\nnote:=two\\nlines \\\\ and: more\nmodality:=again\n") +
             std::string(24, 'x'));
    ASSERT_EQ(contents.fields.size(), 1u);
    const auto& metadata = contents.fields[0]->info().metadata;
    ASSERT_EQ(metadata.size(), 3u);
    EXPECT_EQ(metadata[0].name, "modality");
    EXPECT_EQ(metadata[0].type, "string");
    EXPECT_EQ(metadata[0].value, "MR");
    EXPECT_EQ(metadata[1].value, "two\nlines \\ and: more");
    EXPECT_EQ(metadata[2].name, "content");
}

TEST_F(NrrdInput, ADetachedHeaderReadsBesideItselfAndNowhereElse) {
    fs::create_directory(scratch_ / "sub");
    write("sub/data.raw", "1234567\n" + std::string(24, 'y'));
    write("secret.raw", std::string(24, 's'));
    fs::create_symlink("../secret.raw", scratch_ / "sub/link.raw");
    const auto nhdr = [&](const std::string& data, const std::string& extra = "") {
        return "NRRD0004\r\ntype: uint8\r\ndimension: 3\r\nsizes: 2 3 4\r\nencoding: raw\r\n" + extra +
               "data file: " + data + "\r\n";
    };
    EXPECT_EQ(open(nhdr("sub/data.raw", "byte skip: 8\r\n"), "a.nhdr").fields.size(), 1u);
    EXPECT_EQ(open(nhdr("sub/data.raw", "line skip: 1\r\n"), "a.nhdr").fields.size(), 1u);
    EXPECT_EQ(open(nhdr("./sub/data.raw", "byteskip: -1\r\n"), "a.nhdr").fields.size(), 1u);
    write("sub/b.nhdr", nhdr("../secret.raw"));
    write("sub/c.nhdr", nhdr(path("secret.raw")));
    write("sub/d.nhdr", nhdr("link.raw"));
    write("sub/e.nhdr", nhdr("absent.raw"));
    for (const auto& [name, why] :
         {std::pair("b", "own folder"), {"c", "own folder"}, {"d", "a link out"}, {"e", "absent.raw"}})
        expectOneLineOf(
            brickyard({"convert", path(std::string("sub/") + name + ".nhdr"), path("out.bricks")}), why);
    refuse(nhdr("LIST"), "several files");
    refuse(nhdr("a%03d.raw 1 10 1"), "several files");
}

TEST_F(NrrdInput, HeadersThatLieAreRefusedWithTheFieldAndTheReason) {
    const std::string data(24, 'x');
    refuse("NRRD0006\n" + kSmall + "\n" + data, "newer");
    refuse("NRRD000x\n" + kSmall + "\n" + data, "magic");
    refuse(header(kSmall) + data + "y", "25 bytes");
    refuse(header(kSmall) + data.substr(1), "23 bytes");
    refuse(header("dimension: 3\nsizes: 2 3 4\nencoding: raw\n") + data, "'type'");
    refuse(header("type: block\ndimension: 3\nsizes: 2 3 4\nencoding: raw\n") + data, "block");
    refuse(header("type: short\ndimension: 3\nsizes: 2 3 2\nencoding: raw\n") + data, "endian");
    refuse(header("type: uint8\ndimension: 3\nsizes: 2 3 4\nencoding: bzip2\n") + data, "bzip2");
    refuse(header("type: uint8\ndimension: 2\nsizes: 2 12\nencoding: raw\n") + data, "2 axes");
    refuse(header("type: uint8\ndimension: 4\nsizes: 2 3 2 2\nencoding: raw\n") + data, "4 axes");
    refuse(header("type: uint8\ndimension: 4\nsizes: 2 2 3 2\nkinds: domain domain vector domain\nencoding: "
                  "raw\n") +
               data,
           "axis 2");
    refuse(header("type: uint8\ndimension: 4\nsizes: 2 1 3 4\nkinds: vector domain domain domain\nencoding: "
                  "raw\n") +
               data,
           "2 components");
    refuse(
        header(
            "type: uint8\ndimension: 4\nsizes: 2 2 3 2\nkinds: domain domain domain time\nencoding: raw\n") +
            data,
        "'time'");
    for (const char* sizes : {"2 3", "2 3 4 5", "0 3 4", "-2 3 4", "a b c", "2.5 3 4", "99999999999 3 4", ""})
        refuse(header(std::string("type: uint8\ndimension: 3\nencoding: raw\nsizes: ") + sizes + "\n") + data,
               "sizes");
    refuse(header("type: double\nendian: big\ndimension: 3\nsizes: 2147483647 2147483647 "
                  "2147483647\nencoding: raw\n"),
           "impossible");
    refuse(
        header("type: uint8\ndimension: 3\nsizes: 99999999 99999999 999\nencoding: gzip\n") + gzipped(data),
        "more than any file");
    refuse(header("type: uint8\ndimension: 3\nsizes: 99999 99999 9999\nencoding: gzip\n") + gzipped(data),
           "cannot hold");
    refuse(header("type: uint8\ndimension: 3\nsizes: 2 3 4\nencoding: gzip\n") +
               gzipped(std::string(50'000'000, 'x')),
           "more than the 24");
    refuse(header("type: uint8\ndimension: 3\nsizes: 2 3 4\nencoding: gzip\n") + data, "damaged");
    refuse(header("type: uint8\ndimension: 99999999999\nsizes: 1\nencoding: raw\n") + data, "dimension");
    refuse(header(kSmall + "space directions: (1,0,0) (0,1,0) (1,1,0)\n") + data, "no usable transform");
    refuse(header(kSmall + "space directions: (nan,0,0) (0,1,0) (0,0,1)\n") + data, "no usable transform");
    refuse(header(kSmall + "space directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (inf,0,0)\n") + data,
           "no usable transform");
    refuse(header(kSmall + "space directions: (1,0) (0,1) (0,0)\n") + data, "space directions");
    refuse(header(kSmall + "space directions: (1,0,0\n") + data, "space directions");
    refuse(header(kSmall + "spacings: 0 1 1\n") + data, "no usable transform");
    refuse(header(kSmall + "spacings: x 1 1\n") + data, "spacings");
    refuse(header(kSmall + "type: int8\n") + data, "twice");
    refuse(header(kSmall + "byte skip: 99999999999999999999\n") + data, "byte skip");
    refuse(header(kSmall + "byte skip: 25\n") + data, "behind 25 skipped");
    refuse(header(kSmall + "line skip: 1000000000000\n") + data, "fewer lines");
    refuse("NRRD0005\n" + std::string(2 << 20, '#'), "no end");
    refuse(header("nonsense\n" + kSmall) + data, "nonsense");
}

TEST_F(NrrdInput, EveryTruncationIsRefused) {
    const std::string whole = header(kSmall + "content: a\n") + std::string(24, 'x');
    for (std::size_t size = 8; size < whole.size(); ++size) {
        const auto contents = openInput(write("cut.nrrd", whole.substr(0, size)), {});
        ASSERT_FALSE(contents) << "accepted the first " << size << " of " << whole.size() << " bytes";
    }
}

std::string gunzipped(const std::string& file, std::size_t begin, std::size_t bytes) {
    std::string out(bytes, '\0');
    z_stream stream{};
    const std::string packed = readFile(file).substr(begin);
    ::inflateInit2(&stream, 15 + 16);
    stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(packed.data()));
    stream.avail_in = uInt(packed.size());
    stream.next_out = reinterpret_cast<Bytef*>(out.data());
    stream.avail_out = uInt(out.size());
    EXPECT_EQ(::inflate(&stream, Z_FINISH), Z_STREAM_END);
    ::inflateEnd(&stream);
    return out;
}

TEST_F(NrrdInput, TheSharedVolumesAreWhatTheirBytesSay) {
    const char* shared = std::getenv("BRICKYARD_SHARED_DATA");
    const fs::path folder =
        fs::path(shared ? shared : BRICKYARD_TEST_DATA "/../../../shared/data") / "volumes";
    if (!fs::is_directory(folder)) GTEST_SKIP() << "no shared data at " << folder;
    struct Volume {
        std::string file, data, type;
        std::int64_t nx, ny, nz;
        glm::dvec3 first, next;
    };
    for (const Volume& volume :
         {Volume{
              "mri_colin27_181x217x181_uint8.nrrd", "", "uint8", 181, 217, 181, {90, 125, -71}, {-1, -1, 1}},
          Volume{"mri_vs_seg_001_low_512x512x20_uint16.nrrd",
                 "",
                 "uint16",
                 512,
                 512,
                 20,
                 {-106.32680907019, -123.07443807356, -92.000669002533},
                 {0.41015625, 0.41015625, 1.5}},
          Volume{"mri_gd_176x188x144_uint8.nhdr",
                 "mri_gd_176x188x144_uint8.raw",
                 "uint8",
                 176,
                 188,
                 144,
                 {85.712646484375, 112.45329284667969, -56.81804656982422},
                 {-0.976284384727478 - 0.022005438804626465 + 0.007811427116394043,
                  0.02101755142211914 - 0.9702104330062866 - 0.1121056079864502,
                  0.01001960039138794 - 0.10899937152862549 + 0.9962821006774902}}}) {
        RawFile raw{volume.nx, volume.ny, volume.nz, volume.type, false, false, ""};
        const std::size_t bytes = std::size_t(raw.nx * raw.ny * raw.nz) * raw.width();
        const std::string file = (folder / volume.file).string();
        raw.bytes = volume.data.empty() ? gunzipped(file, readFile(file).find("\n\n") + 2, bytes)
                                        : readFile(folder / volume.data);
        const auto contents = openInput(file, {});
        ASSERT_TRUE(contents) << contents.error().message;
        const FieldSource& field = *contents->fields[0];
        expectValues(field, raw, {{0, 0, 0}, {raw.nx, raw.ny, raw.nz}});
        EXPECT_EQ(field.info().index_to_world.point({0, 0, 0}), volume.first);
        const glm::dvec3 step = field.info().index_to_world.point({1, 1, 1}) - volume.first;
        EXPECT_LT(glm::length(step - volume.next), 1e-12);
        EXPECT_EQ(field.info().source_type, volume.type);
        const std::string out = path(volume.file + ".bricks");
        ASSERT_EQ(brickyard({"convert", file, out, "--name", "mri"}).status, 0);
        const auto same = brickyard({"verify", out, "--against", file, "--name", "mri"});
        EXPECT_EQ(same.status, 0) << same.err;
        EXPECT_THAT(same.out, HasSubstr("every voxel is bit-exact"));
    }
}

}  // namespace
}  // namespace brickyard
