/* SPDX-License-Identifier: MIT */
/*
 * The golden iiwa14 with its controller, to compile codegen/stiffgen/control/python by itself. Sizes of tables are
 * examples.
 */
#ifndef CONTROLLED_ROBOT_H
#define CONTROLLED_ROBOT_H

#include "robot.h"

#include "iiwa14_impedance.h"
#include "iiwa14_find_posture.h"
#include "iiwa14_follow.h"
#include "iiwa14_gains.h"
#include "iiwa14_paper.h"
#include "iiwa14_policy.h"
#include "iiwa14_press.h"
#include "iiwa14_settle.h"

#define ID(name) IIWA14_##name
#define CALL(name) iiwa14_##name

typedef iiwa14_impedance_config config_t;
typedef iiwa14_impedance_state state_t;
typedef iiwa14_impedance_input input_t;
typedef iiwa14_impedance_output output_t;
typedef iiwa14_follow_config follow_config_t;
typedef iiwa14_follow_state follow_state_t;
typedef iiwa14_follow_input follow_input_t;
typedef iiwa14_follow_output follow_output_t;
typedef iiwa14_policy_config policy_config_t;
typedef iiwa14_policy_state policy_state_t;
typedef iiwa14_policy_proposal policy_proposal_t;
typedef iiwa14_policy_output policy_output_t;
typedef iiwa14_settle_config settle_config_t;
typedef iiwa14_settle_state settle_state_t;
typedef iiwa14_settle_input settle_input_t;
typedef iiwa14_settle_output settle_output_t;
typedef iiwa14_press_config press_config_t;
typedef iiwa14_press_state press_state_t;
typedef iiwa14_press_input press_input_t;
typedef iiwa14_press_output press_output_t;
typedef iiwa14_paper_config paper_config_t;
typedef iiwa14_paper_state paper_state_t;
typedef iiwa14_paper_input paper_input_t;
typedef iiwa14_paper_output paper_output_t;

enum { MOTORS = 7, TIPS = 1, FIELDS = 200, STRUCTURES = 9, CHOICES = 10, STATUSES = 20, OUTCOMES = 100 };

#endif
