// SPDX-License-Identifier: MIT
// Configuration that the parameters take their defaults from.
#pragma once

#include "robot.hpp"

namespace stiffgen_ros2 {

inline robot::Config default_config()
{
    robot::Config config = robot::Impedance::default_config();
    return config;
}

} // namespace stiffgen_ros2
