#include "server/offer.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "core/printable_name.h"

namespace brickyard {

std::vector<std::string> Offer::names() const {
    auto names = catalog_->names();
    std::erase_if(names, [&](const std::string& name) { return !access_.allows(name); });
    return names;
}

Error Offer::noSuchDataset(const std::string& name) const {
    const auto there = names();
    return {ErrorCode::kNotFound,
            fmt::format("no dataset '{}' here; there are: {}", printableName(name),
                        there.empty() ? "none" : fmt::format("{}", fmt::join(there, ", ")))};
}

Result<std::shared_ptr<const Dataset>> Offer::dataset(const std::string& name) const {
    if (access_.allows(name))
        if (auto found = catalog_->dataset(name)) return found;
    return tl::unexpected(noSuchDataset(name));
}

Result<ServedFrame> Offer::frame(const std::string& name, std::optional<std::uint32_t> number) const {
    if (auto known = dataset(name); !known) return tl::unexpected(known.error());
    return catalog_->frame(name, number);
}

std::shared_ptr<const FrameReader> Offer::openedFrame(const std::string& name, std::uint32_t number) const {
    return access_.allows(name) ? catalog_->openedFrame(name, number) : nullptr;
}

}  // namespace brickyard
