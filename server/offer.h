// What one client may see of a catalog: the datasets that its token opens. To anybody else the others do not
// exist. Any thread.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "server/access_tokens.h"
#include "server/catalog.h"

namespace brickyard {

class Offer {
public:
    Offer(const Catalog& catalog, Access access) : catalog_(&catalog), access_(std::move(access)) {}

    std::vector<std::string> names() const;
    // Errors: kNotFound, names the datasets there are for this client; and those of Catalog.
    Result<std::shared_ptr<const Dataset>> dataset(const std::string& name) const;
    Result<ServedFrame> frame(const std::string& name, std::optional<std::uint32_t> number) const;
    // Never waits for the disk: nullptr where the frame is not open.
    std::shared_ptr<const FrameReader> openedFrame(const std::string& name, std::uint32_t number) const;

private:
    Error noSuchDataset(const std::string& name) const;

    const Catalog* catalog_;
    Access access_;
};

}  // namespace brickyard
