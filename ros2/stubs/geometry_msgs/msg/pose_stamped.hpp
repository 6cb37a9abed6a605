// SPDX-License-Identifier: MIT
// Stub of geometry_msgs for tests: README.md.
#pragma once

#include "stub/messages.hpp"
