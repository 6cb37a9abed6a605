/* SPDX-License-Identifier: MIT */
/* Kernels and tables of the stub robot, in closed form. */
#include "impedance.h"

void stiffgen_poses(const double *q, const memory_t *m, double *pose)
{
    (void)m;
    memset(pose, 0, 16 * sizeof(double));
    for (int i = 0; i < 3; ++i) {
        pose[5 * i] = 1.0;
        pose[4 * i + 3] = q[i];
    }
    pose[15] = 1.0;
}

void stiffgen_jacobians(const double *q, const memory_t *m, double *jacobian)
{
    (void)q;
    (void)m;
    memset(jacobian, 0, 6 * N * sizeof(double));
    for (int i = 0; i < 3; ++i) {
        jacobian[i * (N + 1)] = 1.0;
    }
}

void stiffgen_spring_wrench(const double *q, const memory_t *m, const double *equilibrium,
                            const double *translation_stiffness, const double *rotation_stiffness, double *wrench)
{
    (void)m;
    (void)rotation_stiffness; /* no joint turns the tip */
    memset(wrench, 0, 6 * sizeof(double));
    for (int k = 0; k < 9; ++k) {
        wrench[k / 3] += translation_stiffness[k] * (q[k % 3] - equilibrium[4 * (k % 3) + 3]);
    }
}

double stiffgen_spring(const double *q, const memory_t *m, const double *equilibrium,
                       const double *translation_stiffness, const double *rotation_stiffness, double *torque,
                       double *joint_stiffness)
{
    double energy = 0.0, wrench[6];
    stiffgen_spring_wrench(q, m, equilibrium, translation_stiffness, rotation_stiffness, wrench);
    memset(torque, 0, N * sizeof(double));
    memset(joint_stiffness, 0, NN * sizeof(double));
    for (int i = 0; i < 3; ++i) {
        torque[i] = -wrench[i];
        energy += 0.5 * (q[i] - equilibrium[4 * i + 3]) * wrench[i];
        memcpy(joint_stiffness + i * N, translation_stiffness + 3 * i, 3 * sizeof(double));
    }
    return energy;
}

double stiffgen_spring_energy(const double *q, const memory_t *m, const double *equilibrium,
                              const double *translation_stiffness, const double *rotation_stiffness)
{
    double torque[N], tangent[NN];
    return stiffgen_spring(q, m, equilibrium, translation_stiffness, rotation_stiffness, torque, tangent);
}

void stiffgen_mass_matrix(const double *q, const memory_t *m, double *mass_matrix)
{
    (void)q;
    (void)m;
    memset(mass_matrix, 0, NN * sizeof(double));
    for (int i = 0; i < N; ++i) {
        mass_matrix[i * (N + 1)] = 2.0;
    }
}

void stiffgen_coriolis(const double *q, const memory_t *m, const double *velocity, double *forces)
{
    (void)q;
    (void)m;
    (void)velocity;
    memset(forces, 0, N * sizeof(double));
}

void stiffgen_home(arm_t *arm)
{
    (void)arm;
}

int stiffgen_reaches(const double *q, const memory_t *m)
{
    (void)q;
    (void)m;
    return 1;
}

void stiffgen_retract(const memory_t *m, double *q)
{
    (void)m;
    (void)q;
}

int stiffgen_follow(const double *q, const memory_t *m, double *joints)
{
    (void)q;
    (void)m;
    joints[0] = 0.0;
    return 1;
}

void stiffgen_adopt(const double *joints, arm_t *arm)
{
    (void)joints;
    (void)arm;
}

int stiffgen_turns(int joint)
{
    (void)joint;
    return 0;
}

int check_fields(const config_t *c)
{
    return doubles_within(&c->sample_time, 1, 1e-5, 0.1) ? ID(OK) : ID(E_CONFIG_SAMPLE_TIME);
}

int check_tools(const config_t *c)
{
    (void)c;
    return ID(OK);
}

int fault_of_reason(int reason)
{
    return reason == ID(REASON_NONE) ? ID(FAULT_NONE) : ID(FAULT_COMMUNICATION);
}

const char *meaning_of_reason(int reason)
{
    return reason == ID(REASON_FROZEN) ? "frozen" : "another reason";
}

const char *seen_of_reason(int reason)
{
    return reason == ID(REASON_FROZEN) ? "motion" : "";
}

const char *stiffgen_joint(int joint)
{
    (void)joint;
    return "joint";
}

const char *meaning_of_refusal(int refusal)
{
    return refusal == ID(REFUSAL_NONE) ? "not refused" : "refused";
}

const char *name_of_command(int command)
{
    return command == ID(COMMAND_NONE) ? "" : "argument";
}

int fits_memory(const memory_t *m)
{
    return integers_within(&m->account.gap, 1, 0, 2 * LONGEST);
}

void report_memory(const memory_t *m, output_t *out)
{
    out->reason = m->fault.reason;
    out->tank = m->account.tank;
    out->scale = m->reference.scale;
}
