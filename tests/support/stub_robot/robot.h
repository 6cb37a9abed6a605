/* SPDX-License-Identifier: MIT */
/*
 * A stub robot, to compile the controller's library (codegen/stiffgen/control/core/library) by itself: seven sliding
 * joints with the structs of the golden iiwa14. The first three move the tip along x, y, z; no joint turns it. Each
 * joint moves 2 kg.
 */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_impedance.h"

#ifndef STUB_ROWS
#define STUB_ROWS 7 /* another number for the functions of matrices alone */
#endif

enum { N = STUB_ROWS, NN = N * N, TIPS = 1, LOOP_JOINTS = 1 };

#define ID(name) IIWA14_##name

typedef iiwa14_impedance_config config_t;
typedef iiwa14_impedance_memory memory_t;
typedef iiwa14_impedance_state state_t;
typedef iiwa14_impedance_input input_t;
typedef iiwa14_impedance_output output_t;
typedef iiwa14_impedance_arm arm_t;
typedef iiwa14_impedance_watch watch_t;
typedef iiwa14_impedance_fault fault_t;
typedef iiwa14_impedance_reference reference_t;
typedef iiwa14_impedance_account account_t;

#endif
