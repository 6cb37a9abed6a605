// SPDX-License-Identifier: MIT
// Stub of rclcpp_lifecycle for tests: README.md.
#pragma once

namespace rclcpp_lifecycle {

class State {};

namespace node_interfaces {

class LifecycleNodeInterface {
public:
    enum class CallbackReturn { SUCCESS, FAILURE, ERROR };

    virtual ~LifecycleNodeInterface() = default;
    virtual CallbackReturn on_configure(const State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_cleanup(const State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_shutdown(const State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_activate(const State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_deactivate(const State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_error(const State &) { return CallbackReturn::FAILURE; }
};

} // namespace node_interfaces
} // namespace rclcpp_lifecycle
