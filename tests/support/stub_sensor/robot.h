/* SPDX-License-Identifier: MIT */
/* The golden iiwa14, as far as codegen/stiffgen/core/emit/c/library needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14.h"

#define ID(name) IIWA14_##name
#define CALL(name) iiwa14_##name

#endif
