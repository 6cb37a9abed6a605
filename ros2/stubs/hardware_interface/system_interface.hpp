// SPDX-License-Identifier: MIT
// Stub of hardware_interface for tests: README.md. From Jazzy on the base class holds the interfaces by name.
#pragma once

#include "hardware_interface/handle.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"

#include <cstdint>
#include <map>
#include <unordered_map>
#include <vector>

namespace hardware_interface {

enum class return_type : std::uint8_t { OK = 0, ERROR = 1, DEACTIVATE = 2 };
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

struct ComponentInfo {
    std::string name, type;
    std::vector<InterfaceInfo> command_interfaces, state_interfaces;
    std::unordered_map<std::string, std::string> parameters;
};

struct HardwareInfo {
    std::string name;
    std::unordered_map<std::string, std::string> hardware_parameters;
    std::vector<ComponentInfo> joints;
};

#if RCLCPP_VERSION_MAJOR >= 21
struct HardwareComponentInterfaceParams {
    HardwareInfo hardware_info;
};
#endif

class SystemInterface : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface {
public:
#if RCLCPP_VERSION_MAJOR < 21
    virtual CallbackReturn on_init(const HardwareInfo &info)
    {
        info_ = info;
        return CallbackReturn::SUCCESS;
    }
    virtual std::vector<StateInterface> export_state_interfaces() = 0;
    virtual std::vector<CommandInterface> export_command_interfaces() = 0;
#else
    virtual CallbackReturn on_init(const HardwareComponentInterfaceParams &params)
    {
        info_ = params.hardware_info;
        return CallbackReturn::SUCCESS;
    }
    template <class T> void set_state(const std::string &name, const T &value) { states[name] = value; }
    template <class T = double> T get_command(const std::string &name) const { return commands.at(name); }
    std::map<std::string, double> states, commands; // for tests
#endif
    virtual return_type read(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;
    virtual return_type write(const rclcpp::Time &time, const rclcpp::Duration &period) = 0;

protected:
    HardwareInfo info_;
};

} // namespace hardware_interface
