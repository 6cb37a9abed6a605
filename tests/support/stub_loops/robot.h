/* SPDX-License-Identifier: MIT */
/* A robot of three motors and seven joints, as far as codegen/stiffgen/control/loops needs it to compile by itself. */
#ifndef ROBOT_H
#define ROBOT_H

#define CALL(name) stub_##name

enum { N = 3, JOINTS = 7, TIPS = 1, TWISTS = 1 };

typedef struct {
    double joints[JOINTS];
} arm_t;

typedef struct {
    arm_t arm;
    struct {
        int known;
    } watch;
} memory_t;

void stub_close(const double *q, const double *start, double *joints);
void stub_motors_jacobian(const double *joints, double *jacobian);
void stub_motors_mass_matrix(const double *joints, double *mass_matrix);
void stub_motors_bias_forces(const double *joints, const double *velocity, const double *gravity, double *forces);
void stub_motors_from_joints(
    const double *joints, const double *gradient, const double *hessian, double *motor_gradient, double *motor_hessian);

#endif
