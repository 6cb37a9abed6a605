/* SPDX-License-Identifier: MIT */
/*
 * A stub robot, to compile the controller's library (codegen/stiffgen/control/library) by itself: seven sliding joints with the
 * structs of the golden iiwa14. The first three move the tip along x, y, z; no joint turns it. Each joint moves 2 kg.
 */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_impedance.h"

#ifndef STUB_ROWS
#define STUB_ROWS 7
#endif

enum { N = 7, NN = N * N, TIPS = 1, MAX_ROWS = STUB_ROWS };

#define ID(name) IIWA14_##name

typedef iiwa14_impedance_config config_t;
typedef iiwa14_impedance_memory memory_t;
typedef iiwa14_impedance_state state_t;
typedef iiwa14_impedance_input input_t;
typedef iiwa14_impedance_output output_t;
typedef iiwa14_impedance_proposal proposal_t;
typedef iiwa14_impedance_policy policy_t;

#endif
