// SPDX-License-Identifier: MIT
// Stub of controller_interface for tests: README.md.
#pragma once

#include "controller_interface/controller_interface_base.hpp"

namespace controller_interface {

class ControllerInterface : public ControllerInterfaceBase {};

} // namespace controller_interface
