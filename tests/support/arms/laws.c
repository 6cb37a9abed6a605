/* SPDX-License-Identifier: MIT */
/*
 * Laws in use, written from their formulas: what a tip's spring is in most labs. Damping is 2 zeta sqrt(K) with zeta 0.7
 * for a unit mass, the usual rule; the nullspace has 10 N m/rad and its damping.
 */
#include "arms.h"

#include <math.h>
#include <string.h>

static const double ZETA = 0.7, NULLSPACE = 10.0;

/* Error of the tip: where it is to be less where it is, and the rotation vector (base axes). */
static void find_error(const sample_t *s, const double *H, double *error)
{
    double D[9] = {0.0};
    for (int k = 0; k < 27; ++k) {
        D[k / 3] += s->pose[k / 9 * 4 + k % 3] * H[k / 3 % 3 * 4 + k % 3];
    }
    const double w[3] = {(D[7] - D[5]) / 2.0, (D[2] - D[6]) / 2.0, (D[3] - D[1]) / 2.0};
    const double sine = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), cosine = (D[0] + D[4] + D[8] - 1.0) / 2.0;
    for (int k = 0; k < 3; ++k) {
        error[k] = s->pose[4 * k + 3] - H[4 * k + 3];
        error[k + 3] = sine > 1e-12 ? w[k] * (atan2(sine, cosine) / sine) : 0.0;
    }
}

/* Solve (J W J^T + damping) x = F, W the inverse of the Cholesky factor L's matrix, or the identity without L. */
static void solve_task(const double *J, const double *L, double damping, double *x)
{
    double A[36], columns[6][N];
    for (int k = 0; k < 6; ++k) {
        memcpy(columns[k], J + k * N, sizeof columns[k]);
        if (L != NULL) {
            solve(N, L, columns[k]);
        }
    }
    for (int k = 0; k < 36; ++k) {
        A[k] = k % 7 == 0 ? damping : 0.0;
        for (int i = 0; i < N; ++i) {
            A[k] += J[k / 6 * N + i] * columns[k % 6][i];
        }
    }
    factorise(6, A);
    solve(6, A, x);
}

static void apply_transpose(const double *J, const double *F, double *torque)
{
    for (int k = 0; k < 6 * N; ++k) {
        torque[k % N] += J[k] * F[k / N];
    }
}

/* Add the posture's torque t, without what it does at the tip: t - J^T (J W J^T)^-1 J W t. */
static void add_nullspace(const sample_t *s, const double *J, const double *L, double *torque)
{
    double t[N], moved[N], F[6] = {0.0};
    for (int i = 0; i < N; ++i) {
        moved[i] = t[i] = NULLSPACE * (s->goal[i] - s->q[i]) - 2.0 * ZETA * sqrt(NULLSPACE) * s->dq[i];
    }
    if (L != NULL) {
        solve(N, L, moved);
    }
    for (int k = 0; k < 6 * N; ++k) {
        F[k / N] -= J[k] * moved[k % N];
    }
    solve_task(J, L, 1e-4, F);
    apply_transpose(J, F, torque);
    for (int i = 0; i < N; ++i) {
        torque[i] += t[i];
    }
}

/* 1: rotation vector with projected nullspace. torque = J^T (K e - D J dq) + (I - J^T J^+T) posture. */
static void rotation_vector(const sample_t *s, const double *J, const double *error, const double *twist,
                            double *torque)
{
    double F[6];
    for (int k = 0; k < 6; ++k) {
        const double K = k < 3 ? s->translation[k] : s->rotation[k - 3];
        F[k] = K * error[k] - 2.0 * ZETA * sqrt(K) * twist[k];
    }
    apply_transpose(J, F, torque);
    add_nullspace(s, J, NULL, torque);
}

/* 2: quaternion with clipped error (0.05 m, 0.2) and integral (K / 2 per second, up to 20 N and 2 N m). */
static void clipped(const sample_t *s, memory_t *m, const double *J, const double *error, const double *twist,
                    double *torque)
{
    double F[6], angle = sqrt(error[3] * error[3] + error[4] * error[4] + error[5] * error[5]);
    const double share = angle > 1e-9 ? 2.0 * sin(angle / 2.0) / angle : 1.0; /* twice the vector part */
    for (int k = 0; k < 6; ++k) {
        const double K = k < 3 ? s->translation[k] : s->rotation[k - 3], most = k < 3 ? 0.05 : 0.2;
        const double e = fmin(fmax(k < 3 ? error[k] : share * error[k], -most), most), limit = k < 3 ? 20.0 : 2.0;
        m->integral[k] = fmin(fmax(m->integral[k] + 0.5 * K * e * s->sample_time, -limit), limit);
        F[k] = K * e - 2.0 * ZETA * sqrt(K) * twist[k] + m->integral[k];
    }
    apply_transpose(J, F, torque);
    add_nullspace(s, J, NULL, torque);
}

/* Shorten a vector of three entries to a length. */
static void clip_norm(double *x, double most)
{
    const double size = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]), share = most / fmax(size, most);
    for (int k = 0; k < 3; ++k) {
        x[k] *= share;
    }
}

/* 4: as 1, with the error clipped to 0.05 m and 0.2 rad, its direction kept. */
static void clipped_vector(const sample_t *s, const double *J, double *error, const double *twist, double *torque)
{
    clip_norm(error, 0.05);
    clip_norm(error + 3, 0.2);
    rotation_vector(s, J, error, twist, torque);
}

/* 3: operational space. torque = J^T Lambda (K e - D J dq) / mass + dynamically consistent nullspace. */
static void operational(const sample_t *s, memory_t *m, const double *J, const double *L, const double *error,
                        const double *twist, double *torque)
{
    double F[6];
    for (int k = 0; !m->started && k < 6; ++k) { /* masses that make the gains those of the other laws at the start */
        double unit[6] = {0.0};
        unit[k] = 1.0;
        solve_task(J, L, 1e-4, unit);
        m->inertia[k / 3] += unit[k] / 3.0;
    }
    m->started = 1;
    for (int k = 0; k < 6; ++k) {
        const double w = (k < 3 ? s->translation[k] : s->rotation[k - 3]) / m->inertia[k / 3];
        F[k] = w * error[k] - 2.0 * ZETA * sqrt(w) * twist[k];
    }
    solve_task(J, L, 1e-4, F);
    apply_transpose(J, F, torque);
    add_nullspace(s, J, L, torque);
}

void textbook(int law, const sample_t *s, memory_t *memory, double *torque)
{
    double H[16], J[6 * N], L[N * N], error[6], twist[6] = {0.0};
    memset(torque, 0, N * sizeof *torque);
    ROBOT_(forward_kinematics)(s->q, H);
    ROBOT_(hybrid_jacobian)(s->q, J);
    for (int k = 0; k < 6 * N; ++k) {
        twist[k / N] += J[k] * s->dq[k % N];
    }
    find_error(s, H, error);
    if (law == 1) {
        rotation_vector(s, J, error, twist, torque);
    } else if (law == 2) {
        clipped(s, memory, J, error, twist, torque);
    } else if (law == 4) {
        clipped_vector(s, J, error, twist, torque);
    } else {
        ROBOT_(mass_matrix)(s->q, L);
        factorise(N, L);
        operational(s, memory, J, L, error, twist, torque);
    }
}
