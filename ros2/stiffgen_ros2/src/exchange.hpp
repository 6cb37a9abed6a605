// SPDX-License-Identifier: MIT
// Hand values between the loop and the other threads. The loop's side never waits: no lock, no allocation.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <type_traits>

namespace stiffgen_ros2 {

/// Newest value from one writing thread to one reading thread, by three copies: each side has one for itself.
template <class T> class Latest {
public:
    static_assert(std::is_trivially_copyable_v<T>, "a copy must not allocate");

    void write(const T &value) noexcept
    {
        slots_[back_] = value;
        back_ = middle_.exchange(back_ | FRESH, std::memory_order_acq_rel) & INDEX;
    }

    /// Copy the newest value; return false, and copy nothing, if it has been read already.
    bool read(T &value) noexcept
    {
        if ((middle_.load(std::memory_order_relaxed) & FRESH) == 0) { return false; }
        front_ = middle_.exchange(front_, std::memory_order_acq_rel) & INDEX;
        value = slots_[front_];
        return true;
    }

private:
    static constexpr unsigned INDEX = 3, FRESH = 4;

    std::array<T, 3> slots_{};
    std::atomic<unsigned> middle_{1};
    unsigned front_ = 0, back_ = 2;
};

/// Queue from one writing thread to one reading thread.
template <class T, std::size_t Size> class Queue {
public:
    static_assert(std::is_trivially_copyable_v<T>, "a copy must not allocate");

    /// Append a value; return false if the queue is full.
    bool push(const T &value) noexcept
    {
        const std::size_t end = end_.load(std::memory_order_relaxed), next = (end + 1) % Size;
        if (next == begin_.load(std::memory_order_acquire)) { return false; }
        slots_[end] = value;
        end_.store(next, std::memory_order_release);
        return true;
    }

    /// Take the oldest value; return false if there is none.
    bool pop(T &value) noexcept
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

} // namespace stiffgen_ros2
