#include "client/network_thread.h"

#include <boost/asio/executor_work_guard.hpp>
#include <boost/asio/io_context.hpp>
#include <mutex>
#include <thread>

namespace brickyard {

struct NetworkThread::State {
    boost::asio::io_context io{1};
    boost::asio::executor_work_guard<boost::asio::io_context::executor_type> work{io.get_executor()};
    std::thread thread;
};

NetworkThread::NetworkThread() : state_(std::make_shared<State>()) {
    // Handlers catch what they throw (stream_connection.cpp), so nothing but the end leaves run().
    state_->thread = std::thread([state = state_] { state->io.run(); });
}

NetworkThread::~NetworkThread() {
    state_->io.stop();
    // The last connection may be let go of in one of its own handlers: a thread cannot wait for itself.
    if (state_->thread.get_id() == std::this_thread::get_id())
        state_->thread.detach();
    else
        state_->thread.join();
}

std::shared_ptr<NetworkThread> NetworkThread::shared() {
    static std::mutex mutex;
    static std::weak_ptr<NetworkThread> living;
    const std::lock_guard lock(mutex);
    std::shared_ptr<NetworkThread> thread = living.lock();
    if (!thread) {
        thread = std::make_shared<NetworkThread>();
        living = thread;
    }
    return thread;
}

boost::asio::io_context& NetworkThread::io() { return state_->io; }

}  // namespace brickyard
