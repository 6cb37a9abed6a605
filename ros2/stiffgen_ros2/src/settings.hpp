// SPDX-License-Identifier: MIT
// Settings of the controller, read from the parameters and checked before the loop sees them.
#pragma once

#include "robot.hpp"

#include <rclcpp/parameter.hpp>
#include <rclcpp_lifecycle/lifecycle_node.hpp>

#include <array>
#include <functional>
#include <string>
#include <vector>

namespace stiffgen_ros2 {

/// Blocks of a stiffness.
struct Blocks {
    bool translation, rotation;
};

/// Settings that the loop uses; they may change while it runs. Another configuration restarts the controller.
struct Settings {
    robot::Config config;
    std::array<double, 9> translation_stiffness; ///< [N/m] base axes, row-major
    std::array<double, 9> rotation_stiffness; ///< [N m/rad] axes of the equilibrium, row-major
    robot::Joints posture_stiffness; ///< [N m/rad or N/m]
    std::array<double, 3> gravity; ///< [m/s^2] acceleration of free fall, base axes
    bool compensate_gravity;
    bool differences_positions; ///< the driver has no velocity interface
    double wrench_timeout; ///< [s] age from which a target_wrench counts as 0
    double target_timeout; ///< [s] age from which a target_pose or target_joint is refused
};

/// Settings that stay as they are from on_configure to on_cleanup.
struct Setup {
    std::vector<std::string> joints;
    std::string base_frame;
    bool command_position = false, velocity_interface = true, policy = false;
    double state_rate = 0.0; ///< [1/s]
    std::string ft_sensor; ///< name of a force-torque sensor; empty: none is read
    robot::Calibration calibration; ///< of that sensor
};

using Lookup = std::function<rclcpp::Parameter(const std::string &)>;

/// Declare every parameter with its default. Throws if the given value has another type.
void declare_parameters(rclcpp_lifecycle::LifecycleNode &node);

/// Read the setup. Return why it is refused, or an empty text.
std::string read_setup(const Lookup &lookup, Setup &setup);

/// Read the sample time [s]: the parameter's, else that of the rate [1/s]. Return why it is refused, or an empty text.
std::string read_sample_time(const Lookup &lookup, unsigned update_rate, double &sample_time);

/// Read and check the loop's settings. Return why they are refused, or an empty text.
std::string read_settings(const Lookup &lookup, double sample_time, Settings &settings);

/// Return whether a parameter can change only while the controller is not configured.
bool is_fixed(const std::string &parameter);

/// Return whether the parameter is one of the controller's.
bool is_ours(const std::string &parameter);

/// Return whether the controller must restart to use the other configuration.
bool differs(robot::Config a, robot::Config b);

/// Return a command that holds the middle of the joints' ranges with the settings' stiffness.
robot::Sample command_of(const Settings &settings);

/// Return whether every number is finite.
bool finite(const double *values, std::size_t count);

/// Return why the controller would refuse a command, or an empty text.
std::string refuse(const robot::Config &config, const robot::Sample &command);

} // namespace stiffgen_ros2
