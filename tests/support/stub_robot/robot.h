/* SPDX-License-Identifier: MIT */
/*
 * A stub robot, to compile the controller's core (codegen/stiffgen/control/core/library) by itself: seven sliding joints
 * with the structs of the golden iiwa14. The first three move the tip along x, y, z; no joint turns it. Each joint moves
 * 2 kg.
 */
#ifndef ROBOT_H
#define ROBOT_H

#include "iiwa14_impedance.h"

#ifndef STUB_ROWS
#define STUB_ROWS 7
#endif

enum { N = STUB_ROWS, NN = N * N, TIPS = 1, SPRINGS = 1, TWISTS = 1, LOOP_JOINTS = 1 };

#define ID(name) IIWA14_##name

typedef iiwa14_impedance_config config_t;
typedef iiwa14_impedance_arm arm_t;
typedef iiwa14_impedance_watch watch_t;
typedef iiwa14_impedance_fault fault_t;
typedef iiwa14_impedance_reference reference_t;
typedef iiwa14_impedance_stiffness stiffness_t;
typedef iiwa14_impedance_account account_t;
typedef iiwa14_impedance_memory memory_t;
typedef iiwa14_impedance_state state_t;
typedef iiwa14_impedance_input input_t;
typedef iiwa14_impedance_output output_t;

/* The robot's kernels at its tips, one after the other, and its tables. m: tools, springs' limits, and with closed loops
 * the joints from which they are closed */
void stiffgen_poses(const double *q, const memory_t *m, double *pose);
void stiffgen_jacobians(const double *q, const memory_t *m, double *jacobian);
double stiffgen_spring_energy(const double *q, const memory_t *m, const double *equilibrium,
                              const double *translation_stiffness, const double *rotation_stiffness);
double stiffgen_spring(const double *q, const memory_t *m, const double *equilibrium,
                       const double *translation_stiffness, const double *rotation_stiffness, double *torque,
                       double *joint_stiffness);
void stiffgen_spring_wrench(const double *q, const memory_t *m, const double *equilibrium,
                            const double *translation_stiffness, const double *rotation_stiffness, double *wrench);
void stiffgen_mass_matrix(const double *q, const memory_t *m, double *mass_matrix);
void stiffgen_coriolis(const double *q, const memory_t *m, const double *velocity, double *forces);
void stiffgen_home(arm_t *arm);
int stiffgen_reaches(const double *q, const memory_t *m);
void stiffgen_retract(const memory_t *m, double *q);
int stiffgen_follow(const double *q, const memory_t *m, double *joints);
void stiffgen_adopt(const double *joints, arm_t *arm);
int stiffgen_turns(int joint);
int check_fields(const config_t *c);
int check_tools(const config_t *c);
int fault_of_reason(int reason);
const char *meaning_of_reason(int reason);
const char *seen_of_reason(int reason);
const char *stiffgen_joint(int joint);
const char *meaning_of_refusal(int refusal);
const char *name_of_command(int command);
int fits_memory(const memory_t *m);
void report_memory(const memory_t *m, output_t *out);

#endif
