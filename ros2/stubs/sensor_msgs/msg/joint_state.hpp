// SPDX-License-Identifier: MIT
// Stub of sensor_msgs for tests: README.md.
#pragma once

#include "stub/messages.hpp"
