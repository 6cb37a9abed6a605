// SPDX-License-Identifier: MIT
// Stub of realtime_tools for tests: README.md.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>

namespace realtime_tools {

// Queue from one writing thread to one reading thread, with room for Size - 1 values.
template <class T, std::size_t Size> class LockFreeSPSCQueue {
public:
    [[nodiscard]] bool push(const T &value)
    {
        const std::size_t end = end_.load(std::memory_order_relaxed), next = (end + 1) % Size;
        if (next == begin_.load(std::memory_order_acquire)) { return false; }
        slots_[end] = value;
        end_.store(next, std::memory_order_release);
        return true;
    }

    [[nodiscard]] bool pop(T &value)
    {
        const std::size_t begin = begin_.load(std::memory_order_relaxed);
        if (begin == end_.load(std::memory_order_acquire)) { return false; }
        value = slots_[begin];
        begin_.store((begin + 1) % Size, std::memory_order_release);
        return true;
    }

private:
    std::array<T, Size> slots_{};
    std::atomic<std::size_t> begin_{0}, end_{0};
};

} // namespace realtime_tools
