/* SPDX-License-Identifier: MIT */
/* Two arms of seven joints, as far as codegen/stiffgen/control/carry needs them to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#include <stddef.h>
#include <stdint.h>

#define ID(name) STUB_##name

enum { STUB_FOLLOW_OK, STUB_FOLLOW_E_POSE = -4, STUB_FOLLOW_UNREACHABLE = 8, STUB_FOLLOW_REFUSED = 16 };
enum { N = 14, TIPS = 2 };

typedef struct {
    double sample_time, tip_velocity_limit, tip_rotation_limit, ramp_time;
} config_t;

typedef struct {
    config_t config;
    double q[N], pose[16 * TIPS], grasp[16 * TIPS], object[16], goal[16], carried[6];
    int waits, held;
} state_t;

typedef struct {
    double pose[16 * TIPS], object_pose[16], grasp[16 * TIPS];
} input_t;

typedef struct {
    double error[2 * TIPS];
    uint32_t status;
} output_t;

void stiffgen_poses(const double *q, const double *tool, double *poses);
const double *stiffgen_tool(const input_t *input);
double *stiffgen_kept_tool(state_t *state);

#endif
