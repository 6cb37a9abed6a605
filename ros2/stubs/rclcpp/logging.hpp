// SPDX-License-Identifier: MIT
// Stub of rclcpp for tests: README.md.
#pragma once

#include "stub/world.hpp"

namespace rclcpp {

class Logger {};

inline Logger get_logger(const char *) { return {}; }

} // namespace rclcpp

#define STUB_LOG(level, logger, ...) \
    do { \
        static_cast<void>(logger); \
        ::stub::log(level, __VA_ARGS__); \
    } while (0)
#define RCLCPP_INFO(logger, ...) STUB_LOG("info", logger, __VA_ARGS__)
#define RCLCPP_WARN(logger, ...) STUB_LOG("warn", logger, __VA_ARGS__)
#define RCLCPP_ERROR(logger, ...) STUB_LOG("error", logger, __VA_ARGS__)
