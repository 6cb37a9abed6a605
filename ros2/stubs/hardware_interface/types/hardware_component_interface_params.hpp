// SPDX-License-Identifier: MIT
// Stub of hardware_interface for tests: README.md.
#pragma once

#include "hardware_interface/system_interface.hpp"
