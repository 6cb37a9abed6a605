// SPDX-License-Identifier: MIT
// Stub of rcl_interfaces for tests: README.md.
#pragma once

#include "rclcpp/parameter.hpp"
