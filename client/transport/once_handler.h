// A completion handler whose type is forgotten: move-only, called once. (Boost has any_completion_handler
// from 1.82 on.)
#pragma once

#include <boost/system/error_code.hpp>
#include <cstddef>
#include <memory>
#include <utility>

namespace brickyard {

class OnceHandler {
public:
    OnceHandler() = default;
    template <class Function>
    explicit OnceHandler(Function&& function)
        : call_(std::make_unique<Holder<std::decay_t<Function>>>(std::forward<Function>(function))) {}

    explicit operator bool() const { return call_ != nullptr; }
    // REQUIRES: *this holds a handler; it does not afterwards.
    void operator()(boost::system::error_code error, std::size_t bytes) {
        const auto call = std::move(call_);
        call->run(error, bytes);
    }

private:
    struct Callable {
        virtual ~Callable() = default;
        virtual void run(boost::system::error_code error, std::size_t bytes) = 0;
    };
    template <class Function>
    struct Holder final : Callable {
        explicit Holder(Function&& held) : function(std::move(held)) {}
        explicit Holder(const Function& held) : function(held) {}
        void run(boost::system::error_code error, std::size_t bytes) override {
            // Out of the holder first: a handler may let go of what owns it.
            Function once = std::move(function);
            once(error, bytes);
        }
        Function function;
    };
    std::unique_ptr<Callable> call_;
};

}  // namespace brickyard
