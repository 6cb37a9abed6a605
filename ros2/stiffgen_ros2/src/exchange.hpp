// SPDX-License-Identifier: MIT
// Hand values between the loop and the other threads. The loop's side never waits: no lock, no allocation.
#pragma once

#include <array>
#include <atomic>
#include <type_traits>

namespace stiffgen_ros2 {

/// Newest value from one writing thread to one reading thread, by three copies: each side has one for itself, and
/// neither waits. The boxes of realtime_tools have a lock.
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

} // namespace stiffgen_ros2
