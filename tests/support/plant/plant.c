/* SPDX-License-Identifier: MIT */
#include "plant.h"

#include <math.h>
#include <string.h>

static const double STEP = 1e-5;

void plant_mass_matrix(const plant_t *plant, const double *q, double *M)
{
    robot_mass_matrices(1, q, M);
    for (int i = 0; i < N; ++i) {
        M[i * N + i] += plant->motor[i];
    }
}

/* Coriolis and centrifugal forces; the 2 (N - 1) + 2 mass matrices in one batch. The first joint turns all of the arm. */
void plant_bias(const double *q, const double *v, double *c)
{
    enum { COUNT = 2 * (N - 1) + 2 };
    double points[COUNT * N], M[COUNT * N * N];
    double speed = 0.0;
    for (int i = 0; i < N; ++i) {
        speed = fmax(speed, fabs(v[i]));
    }
    if (speed == 0.0) {
        memset(c, 0, N * sizeof *c);
        return;
    }
    const double along = STEP / speed;
    for (int k = 0; k < COUNT; ++k) {
        memcpy(points + k * N, q, N * sizeof *q);
        const double sign = k % 2 == 0 ? 1.0 : -1.0;
        for (int i = 0; i < N; ++i) {
            points[k * N + i] += k < 2 ? sign * along * v[i] : i == k / 2 ? sign * STEP : 0.0;
        }
    }
    robot_mass_matrices(COUNT, points, M);
    for (int i = 0; i < N; ++i) {
        double sum = 0.0, form = 0.0;
        const double *const up = M + 2 * i * N * N, *const down = up + N * N;
        for (int j = 0; j < N; ++j) {
            sum += (M[i * N + j] - M[N * N + i * N + j]) * v[j];
            for (int k = 0; i > 0 && k < N; ++k) {
                form += (up[j * N + k] - down[j * N + k]) * v[j] * v[k];
            }
        }
        c[i] = sum / (2.0 * along) - form / (4.0 * STEP);
    }
}

double plant_kinetic_energy(const plant_t *plant, const motion_t *motion)
{
    double M[N * N], sum = 0.0;
    plant_mass_matrix(plant, motion->q, M);
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < N; ++j) {
            sum += 0.5 * motion->v[i] * M[i * N + j] * motion->v[j];
        }
    }
    return sum;
}

static void tip_wrench(const plant_t *plant, const double *q, const double *v, const double *J, const forces_t *forces,
                       double *wrench)
{
    memcpy(wrench, forces->load, 6 * sizeof *wrench);
    if (!forces->clamped) {
        return;
    }
    double H[16 * TIPS], turn[9], twist[6];
    const double *const C = forces->clamp_pose;
    robot_poses(q, NULL, H);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            turn[3 * i + j] = 0.0;
            for (int k = 0; k < 3; ++k) {
                turn[3 * i + j] += H[4 * i + k] * C[4 * j + k];
            }
        }
    }
    const double error[6] = {H[3] - C[3], H[7] - C[7], H[11] - C[11],
                             (turn[7] - turn[5]) / 2.0, (turn[2] - turn[6]) / 2.0, (turn[3] - turn[1]) / 2.0};
    for (int i = 0; i < 6; ++i) {
        twist[i] = 0.0;
        for (int j = 0; j < N; ++j) {
            twist[i] += J[i * N + j] * v[j];
        }
        const double k = i < 3 ? plant->clamp_force : plant->clamp_moment;
        wrench[i] -= k * (error[i] + plant->clamp_damping * twist[i]);
    }
}

void plant_tip_wrench(const plant_t *plant, const motion_t *motion, const forces_t *forces, double *wrench)
{
    double J[6 * N];
    robot_jacobian(motion->q, J);
    tip_wrench(plant, motion->q, motion->v, J, forces, wrench);
}

/* Everything but the robot's torque. */
static void environment(const plant_t *plant, const double *q, const double *v, const forces_t *forces, double *tau)
{
    double J[6 * N], wrench[6];
    robot_jacobian(q, J);
    tip_wrench(plant, q, v, J, forces, wrench);
    for (int i = 0; i < N; ++i) {
        tau[i] = forces->push[i] - plant->friction[i] * v[i];
        if (forces->hand_stiffness > 0.0) {
            tau[i] += forces->hand_stiffness * (forces->hand_target[i] - q[i]) - forces->hand_damping * v[i];
        }
        const double depth = robot_depth(i, q[i]);
        if (plant->stop_stiffness > 0.0 && depth != 0.0) {
            const double pressed = plant->stop_stiffness * depth + plant->stop_damping * v[i];
            tau[i] -= depth * pressed > 0.0 ? pressed : 0.0; /* a stop does not hold back */
        }
        for (int k = 0; k < 6; ++k) {
            tau[i] += J[k * N + i] * wrench[k];
        }
    }
}

static void solve(double *M, double *x)
{
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = M[i * N + j];
            for (int k = 0; k < j; ++k) {
                sum -= M[i * N + k] * M[j * N + k];
            }
            M[i * N + j] = i == j ? sqrt(sum) : sum / M[j * N + j];
        }
        for (int k = 0; k < i; ++k) {
            x[i] -= M[i * N + k] * x[k];
        }
        x[i] /= M[i * N + i];
    }
    for (int i = N - 1; i >= 0; --i) {
        for (int k = i + 1; k < N; ++k) {
            x[i] -= M[k * N + i] * x[k];
        }
        x[i] /= M[i * N + i];
    }
}

static void rates(const plant_t *plant, const motion_t *at, const forces_t *forces, motion_t *rate)
{
    double M[N * N], c[N], tau[N];
    plant_mass_matrix(plant, at->q, M);
    plant_bias(at->q, at->v, c);
    environment(plant, at->q, at->v, forces, tau);
    rate->environment_work = rate->robot_work = 0.0;
    for (int i = 0; i < N; ++i) {
        rate->q[i] = at->v[i];
        rate->environment_work += tau[i] * at->v[i];
        const double torque = forces->torque[i] + forces->kp[i] * (forces->q_des[i] - at->q[i]) - forces->kd[i] * at->v[i];
        rate->robot_work += torque * at->v[i];
        rate->v[i] = tau[i] + torque - c[i];
    }
    solve(M, rate->v);
}

static void blend(const motion_t *a, const motion_t *rate, double h, motion_t *sum)
{
    for (int i = 0; i < N; ++i) {
        sum->q[i] = a->q[i] + h * rate->q[i];
        sum->v[i] = a->v[i] + h * rate->v[i];
    }
    sum->environment_work = a->environment_work + h * rate->environment_work;
    sum->robot_work = a->robot_work + h * rate->robot_work;
}

void plant_advance(const plant_t *plant, motion_t *motion, const forces_t *forces, double duration)
{
    const double h = duration / plant->substeps;
    for (int s = 0; s < plant->substeps; ++s) {
        motion_t k1, k2, k3, k4, at;
        rates(plant, motion, forces, &k1);
        blend(motion, &k1, h / 2.0, &at);
        rates(plant, &at, forces, &k2);
        blend(motion, &k2, h / 2.0, &at);
        rates(plant, &at, forces, &k3);
        blend(motion, &k3, h, &at);
        rates(plant, &at, forces, &k4);
        blend(motion, &k1, h / 6.0, motion);
        blend(motion, &k2, h / 3.0, motion);
        blend(motion, &k3, h / 3.0, motion);
        blend(motion, &k4, h / 6.0, motion);
    }
}
