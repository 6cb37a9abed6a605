// SPDX-License-Identifier: MIT
// Read and write loaned interfaces, whose functions differ between the distributions of ROS 2.
#pragma once

#include <optional>
#include <type_traits>

namespace stiffgen_ros2 {

// Jazzy and later: no value while another thread has the interface locked.
template <class Loaned> auto value_of(const Loaned &loaned, int) -> std::decay_t<decltype(loaned.get_optional())>
{
    return loaned.get_optional();
}

// Humble.
template <class Loaned> std::optional<double> value_of(const Loaned &loaned, long) { return loaned.get_value(); }

/// Return the value of a loaned interface, or nothing while it is locked.
template <class Loaned> std::optional<double> value_of(const Loaned &loaned) { return value_of(loaned, 0); }

/// Write a value; return false if a lock prevents it (Jazzy and later).
template <class Loaned> bool set_value(Loaned &loaned, double value)
{
    if constexpr (std::is_void_v<decltype(loaned.set_value(value))>) {
        loaned.set_value(value);
        return true;
    } else {
        return loaned.set_value(value);
    }
}

} // namespace stiffgen_ros2
