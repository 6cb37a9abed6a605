// SPDX-License-Identifier: MIT
// Stub of controller_interface for tests: README.md.
#pragma once

#include "hardware_interface/loaned_interfaces.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"

#include <cstdint>

namespace controller_interface {

using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

enum class return_type : std::uint8_t { OK = 0, ERROR = 1 };
enum class interface_configuration_type : std::uint8_t { ALL = 0, INDIVIDUAL = 1, NONE = 2 };

struct InterfaceConfiguration {
#if RCLCPP_VERSION_MAJOR < 21
    interface_configuration_type type;
#else
    interface_configuration_type type = interface_configuration_type::NONE;
#endif
    std::vector<std::string> names = {};
};

class ControllerInterfaceBase : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface {
public:
    virtual InterfaceConfiguration command_interface_configuration() const = 0;
    virtual InterfaceConfiguration state_interface_configuration() const = 0;
    virtual CallbackReturn on_init() = 0;
    virtual return_type update(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;

    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }
    unsigned int get_update_rate() const { return update_rate_; }

    template <class T> T auto_declare(const std::string &name, const T &value)
    {
        if (node_->has_parameter(name)) { return node_->get_parameter(name).template get_value<T>(); }
        return node_->declare_parameter<T>(name, value);
    }

    // What the tests' manager does.
    bool stub_is_active = false;
    void stub_init(std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node, unsigned int update_rate)
    {
        node_ = std::move(node);
        update_rate_ = update_rate;
    }
    void stub_assign(std::vector<hardware_interface::LoanedCommandInterface> &&commands,
        std::vector<hardware_interface::LoanedStateInterface> &&states)
    {
        command_interfaces_ = std::move(commands);
        state_interfaces_ = std::move(states);
    }

protected:
    std::vector<hardware_interface::LoanedCommandInterface> command_interfaces_;
    std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;

private:
    std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_;
    unsigned int update_rate_ = 0;
};

} // namespace controller_interface
