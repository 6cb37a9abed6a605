// SPDX-License-Identifier: MIT
// Stub of std_msgs for tests: README.md.
#pragma once

#include "stub/messages.hpp"
