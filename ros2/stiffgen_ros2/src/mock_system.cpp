// SPDX-License-Identifier: MIT
// A system for trials without a robot: the simulated arm behind effort interfaces. Its joints start at the
// initial_value of their position, else bent.
#include "simulation.hpp"

#include <hardware_interface/handle.hpp>
#include <hardware_interface/system_interface.hpp>
#include <pluginlib/class_list_macros.hpp>
#include <rclcpp/rclcpp.hpp>
#include <rclcpp/version.h>

#include <limits>
#include <string>
#include <vector>

namespace stiffgen_ros2 {

class MockSystem : public hardware_interface::SystemInterface {
public:
    using Callback = hardware_interface::CallbackReturn;
    using Return = hardware_interface::return_type;

#if RCLCPP_VERSION_MAJOR < 21 // Humble
    Callback on_init(const hardware_interface::HardwareInfo &info) override
    {
        return SystemInterface::on_init(info) == Callback::SUCCESS ? place() : Callback::ERROR;
    }

    std::vector<hardware_interface::StateInterface> export_state_interfaces() override
    {
        std::vector<hardware_interface::StateInterface> exported;
        for (std::size_t i = 0; i < robot::DOF; ++i) {
            exported.emplace_back(name(i), "position", &arm_.q[i]);
            exported.emplace_back(name(i), "velocity", &arm_.dq[i]);
            exported.emplace_back(name(i), "effort", &torque_[i]);
        }
        return exported;
    }

    std::vector<hardware_interface::CommandInterface> export_command_interfaces() override
    {
        std::vector<hardware_interface::CommandInterface> exported;
        for (std::size_t i = 0; i < robot::DOF; ++i) { exported.emplace_back(name(i), "effort", &torque_[i]); }
        return exported;
    }

    Return read(const rclcpp::Time &, const rclcpp::Duration &period) override
    {
        arm_.step(torque_, period.seconds());
        return Return::OK;
    }

    Return write(const rclcpp::Time &, const rclcpp::Duration &) override { return Return::OK; }
#else
    Callback on_init(const hardware_interface::HardwareComponentInterfaceParams &params) override
    {
        return SystemInterface::on_init(params) == Callback::SUCCESS ? place() : Callback::ERROR;
    }

    Return read(const rclcpp::Time &, const rclcpp::Duration &period) override
    {
        arm_.step(torque_, period.seconds());
        for (std::size_t i = 0; i < robot::DOF; ++i) {
            set_state(name(i) + "/position", arm_.q[i]);
            set_state(name(i) + "/velocity", arm_.dq[i]);
            set_state(name(i) + "/effort", torque_[i]);
        }
        return Return::OK;
    }

    Return write(const rclcpp::Time &, const rclcpp::Duration &) override
    {
        for (std::size_t i = 0; i < robot::DOF; ++i) { torque_[i] = get_command<double>(name(i) + "/effort"); }
        return Return::OK;
    }
#endif

private:
    const std::string &name(std::size_t i) const { return info_.joints[i].name; }

    // Return a position within the limits and a radian of zero: the middle for every other joint, so that the arm is bent.
    static double bent(std::size_t i)
    {
        const double lower = std::max(robot::LOWER[i], -1.0), upper = std::min(robot::UPPER[i], 1.0);
        const double share = i % 2 == 0 ? 0.5 : 0.75;
        return lower < upper ? lower + share * (upper - lower) : robot::LOWER[i];
    }

    // Place the arm. Return an error if the description has other joints than the robot.
    Callback place()
    {
        if (info_.joints.size() != robot::DOF) {
            RCLCPP_ERROR(rclcpp::get_logger("MockSystem"), "%zu joints in the ros2_control element; the robot has %zu, from base to tip",
                info_.joints.size(), robot::DOF);
            return Callback::ERROR;
        }
        torque_.fill(std::numeric_limits<double>::quiet_NaN()); // as drivers begin; counts as 0
        for (std::size_t i = 0; i < robot::DOF; ++i) {
            arm_.q[i] = bent(i);
            for (const auto &state : info_.joints[i].state_interfaces) {
                if (state.name == "position" && !state.initial_value.empty()) { arm_.q[i] = std::stod(state.initial_value); }
            }
        }
        return Callback::SUCCESS;
    }

    Simulation arm_;
    robot::Joints torque_{};
};

} // namespace stiffgen_ros2

PLUGINLIB_EXPORT_CLASS(stiffgen_ros2::MockSystem, hardware_interface::SystemInterface)
