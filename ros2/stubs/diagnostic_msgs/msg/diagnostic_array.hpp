// SPDX-License-Identifier: MIT
// Stub of diagnostic_msgs for tests: README.md.
#pragma once

#include "stub/messages.hpp"
