// Connections that share a thread: as many as one likes, each of them gone when it is gone.
#include "client/network_thread.h"

#include <gmock/gmock.h>

#include <atomic>
#include <filesystem>
#include <mutex>
#include <random>
#include <thread>

#include "client/remote_source.h"
#include "client/stream_connection.h"
#include "core/stream_frame.h"
#include "server/server.h"
#include "tiny_dataset.h"

namespace brickyard {
namespace {

using Clock = std::chrono::steady_clock;

std::ptrdiff_t threadsOfThisProcess() {
    std::filesystem::directory_iterator tasks("/proc/self/task");
    return std::distance(begin(tasks), end(tasks));
}

class NetworkThreadTest : public testing::Test {
protected:
    NetworkThreadTest() {
        ServerOptions options;
        options.port = 0;
        options.max_connections = 2000;
        server_ =
            std::move(*Server::start(std::move(*Catalog::open({tiny_.folder()}, 8, 1u << 20)), options));
        address_.host = "127.0.0.1";
        address_.port = server_->port();
        address_.dataset = "tiny";
    }
    // Greets, and pings as often as it is asked, until it is destroyed.
    StreamConnection::Handlers pinging(std::function<bool()> on_message) {
        StreamConnection::Handlers handlers;
        handlers.on_open = [] {};
        handlers.on_lost = [](const Error&) {};
        handlers.on_message = [on_message](std::span<const std::byte>) { return on_message(); };
        auto greeted = std::make_shared<bool>(false);
        handlers.next_message = [greeted] {
            StreamHeader header;
            if (!std::exchange(*greeted, true))
                header.mutable_hello()->set_protocol_major(kProtocolMajor);
            else
                header.mutable_ping()->set_number(1);
            return encodeStreamHead(header);
        };
        return handlers;
    }

    TinyDataset tiny_{"tiny", {.levels = 3, .payload_bytes = 96}};
    std::unique_ptr<Server> server_;
    StreamAddress address_;
};

TEST_F(NetworkThreadTest, AThousandSourcesShareOne) {
    const auto before = threadsOfThisProcess();
    const auto thread = std::make_shared<NetworkThread>();
    std::vector<std::unique_ptr<RemoteSource>> sources;
    for (int i = 0; i < 1000; ++i) {
        auto source = RemoteSource::open(address_, "", {}, {}, thread);
        ASSERT_TRUE(source) << i << ": " << source.error().message;
        sources.push_back(std::move(*source));
    }
    EXPECT_EQ(threadsOfThisProcess(), before + 1);
    const auto bricks = tiny_.bricks(0);
    for (std::size_t i = 0; i < sources.size(); ++i) {
        ASSERT_TRUE(sources[i]->openFrame(30));
        PageWish wish;
        wish.pages.push_back({false, bricks[i % bricks.size()]});
        wish.credit_bytes = 1u << 20;
        ASSERT_TRUE(sources[i]->wish(wish));
    }
    for (std::size_t i = 0; i < sources.size(); ++i) {
        const auto arrivals = sources[i]->take(Clock::now() + std::chrono::seconds(60));
        ASSERT_TRUE(arrivals && arrivals->size() == 1) << i;
        EXPECT_EQ(*arrivals->front().bytes, tiny_.payload(bricks[i % bricks.size()]));
    }
}

TEST_F(NetworkThreadTest, ItLivesAsLongAsSomebodyHoldsIt) {
    const auto before = threadsOfThisProcess();
    {
        auto one = RemoteSource::open(address_, "");
        auto two = RemoteSource::open(address_, "");
        EXPECT_TRUE(one && two);
        EXPECT_EQ(threadsOfThisProcess(), before + 1);
        EXPECT_EQ(NetworkThread::shared(), NetworkThread::shared());
    }
    EXPECT_EQ(threadsOfThisProcess(), before);
    EXPECT_TRUE(RemoteSource::open(address_, "")) << "and starts again";
}

TEST_F(NetworkThreadTest, NothingRunsOnceAConnectionIsDestroyed) {
    const auto thread = std::make_shared<NetworkThread>();
    std::minstd_rand random(1);
    for (int i = 0; i < 60; ++i) {
        // The sanitizers see a handler that comes too late.
        auto calls = std::make_unique<std::atomic<int>>(0);
        StreamConnection connection(address_, {}, pinging([raw = calls.get()] { return ++*raw > 0; }),
                                    thread);
        std::this_thread::sleep_for(std::chrono::microseconds(random() % 4000));
        std::thread([&] { connection.wakeSender(); }).join();
        const StreamConnection unborn(address_, {}, pinging([] { return true; }), thread);
    }
}

TEST_F(NetworkThreadTest, AHandlerMayDestroyItsConnectionAndTheThread) {
    std::atomic<bool> destroyed{false};
    std::mutex mutex;  // guards the pointer until it is set
    std::unique_ptr<StreamConnection> connection;
    {
        const std::lock_guard lock(mutex);
        auto destroy = [&] {
            {
                const std::lock_guard set(mutex);
                connection.reset();
            }
            // Last: the test ends with it, and the thread may end after the test.
            destroyed = true;
            return true;
        };
        connection = std::make_unique<StreamConnection>(address_, StreamTimeouts(), pinging(destroy),
                                                        std::make_shared<NetworkThread>());
    }
    for (int i = 0; i < 1000 && !destroyed; ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    EXPECT_TRUE(destroyed);
}

TEST_F(NetworkThreadTest, WhatAHandlerThrowsEndsItsConnectionOnly) {
    const auto thread = std::make_shared<NetworkThread>();
    std::atomic<bool> lost{false};
    auto handlers = pinging([]() -> bool { throw std::bad_alloc(); });
    handlers.on_lost = [&](const Error&) { lost = true; };
    const StreamConnection bad(address_, {}, std::move(handlers), thread);
    for (int i = 0; i < 1000 && !lost; ++i) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    EXPECT_TRUE(lost);
    EXPECT_TRUE(RemoteSource::open(address_, "", {}, {}, thread));
}

}  // namespace
}  // namespace brickyard
