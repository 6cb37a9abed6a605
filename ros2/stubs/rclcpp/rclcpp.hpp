// SPDX-License-Identifier: MIT
// Stub of rclcpp for tests: README.md.
#pragma once

#include "rclcpp_lifecycle/lifecycle_node.hpp"
