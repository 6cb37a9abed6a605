/* SPDX-License-Identifier: MIT */
/* The golden iiwa14, as far as codegen/stiffgen/control/policy needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_policy.h"

#define ID(name) IIWA14_##name

enum { TIPS = 1 };

typedef iiwa14_policy_config config_t;
typedef iiwa14_policy_state policy_t;
typedef iiwa14_policy_proposal proposal_t;
typedef iiwa14_policy_output output_t;

#endif
