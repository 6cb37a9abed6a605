// SPDX-License-Identifier: MIT
// Settings of the controller, read from the parameters and checked before the loop sees them.
#pragma once

#include "robot.hpp"

#include <rclcpp/parameter.hpp>
#include <rclcpp_lifecycle/lifecycle_node.hpp>

#include <array>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

namespace stiffgen_ros2 {

/// Settings that the loop uses; they may change while it runs.
struct Settings {
    robot::Config config;
    std::array<double, 9> translation_stiffness; ///< [N/m] base axes, row-major
    std::array<double, 9> rotation_stiffness; ///< [N m/rad] axes of the equilibrium, row-major
    std::array<double, 3> gravity; ///< [m/s^2] acceleration of free fall, base axes
    bool compensate_gravity;
    double wrench_timeout; ///< [s] age from which a target_wrench counts as 0
    double target_timeout; ///< [s] age from which a target_pose or target_joint is refused
    /// Place of the stiffness in the order of parameters and commands: the newest counts.
    std::uint64_t translation_order, rotation_order;
};

/// Settings that stay as they are from on_configure to on_cleanup.
struct Setup {
    std::vector<std::string> joints;
    std::string base_frame;
    bool command_position = false, policy = false;
    double state_rate = 0.0; ///< [1/s]
    std::string ft_sensor; ///< name of a force-torque sensor; empty: none is read
    robot::Calibration calibration; ///< of that sensor
};

/// Which blocks of the stiffness a change of parameters sets.
struct Assigned {
    bool translation, rotation;
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

/// Write blocks of the settings' stiffness into a stiffness (6 x 6, row-major).
inline void copy_stiffness(const Settings &settings, const Assigned &blocks, double *stiffness)
{
    for (std::size_t row = 0; row < 3; ++row) {
        for (std::size_t column = 0; column < 3; ++column) {
            if (blocks.translation) { stiffness[6 * row + column] = settings.translation_stiffness[3 * row + column]; }
            if (blocks.rotation) { stiffness[6 * (row + 3) + column + 3] = settings.rotation_stiffness[3 * row + column]; }
        }
    }
}

/// Return why a stiffness (6 x 6, row-major) is refused, or an empty text.
std::string refuse_stiffness(const robot::Config &config, const double *stiffness);

/// Return why a pose (4 x 4, row-major) is refused, or an empty text.
std::string refuse_pose(const robot::Config &config, const double *pose);

/// Return why joint positions are refused, or an empty text.
std::string refuse_positions(const robot::Config &config, const double *q0);

} // namespace stiffgen_ros2
