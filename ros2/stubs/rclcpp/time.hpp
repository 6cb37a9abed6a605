// SPDX-License-Identifier: MIT
// Stub of rclcpp for tests: README.md.
#pragma once

#include <cmath>
#include <cstdint>

namespace builtin_interfaces {
namespace msg {

struct Time {
    std::int32_t sec = 0;
    std::uint32_t nanosec = 0;
};

} // namespace msg
} // namespace builtin_interfaces

namespace rclcpp {

class Duration {
public:
    explicit Duration(std::int32_t seconds, std::uint32_t nanoseconds) : nanoseconds_(seconds * 1000000000LL + nanoseconds) {}
    static Duration from_seconds(double seconds) { return Duration(std::llround(seconds * 1e9)); }
    double seconds() const { return 1e-9 * static_cast<double>(nanoseconds_); }
    std::int64_t nanoseconds() const { return nanoseconds_; }

private:
    explicit Duration(std::int64_t nanoseconds) : nanoseconds_(nanoseconds) {}

    std::int64_t nanoseconds_;
};

class Time {
public:
    explicit Time(std::int64_t nanoseconds = 0) : nanoseconds_(nanoseconds) {}
    Time(const builtin_interfaces::msg::Time &time) : nanoseconds_(time.sec * 1000000000LL + time.nanosec) {}
    operator builtin_interfaces::msg::Time() const
    {
        builtin_interfaces::msg::Time time;
        time.sec = static_cast<std::int32_t>(nanoseconds_ / 1000000000LL);
        time.nanosec = static_cast<std::uint32_t>(nanoseconds_ % 1000000000LL);
        return time;
    }
    double seconds() const { return 1e-9 * static_cast<double>(nanoseconds_); }
    std::int64_t nanoseconds() const { return nanoseconds_; }

private:
    std::int64_t nanoseconds_;
};

} // namespace rclcpp
