// The thread on which connections run their handlers: one for as many connections as there are, because it
// only moves bytes. Any thread may call, and may let go of it.
#pragma once

#include <memory>

namespace boost::asio {
class io_context;
}

namespace brickyard {

class NetworkThread {
public:
    NetworkThread();
    // Ends the thread; what its connections still had to do is dropped, so each connection holds it by a
    // pointer of its own.
    ~NetworkThread();
    NetworkThread(const NetworkThread&) = delete;
    NetworkThread& operator=(const NetworkThread&) = delete;

    // The one of this process: starts when it is first asked for and ends with the last that holds it.
    static std::shared_ptr<NetworkThread> shared();

    boost::asio::io_context& io();

private:
    struct State;
    std::shared_ptr<State> state_;  // shared with the thread, which may end after its owner
};

}  // namespace brickyard
