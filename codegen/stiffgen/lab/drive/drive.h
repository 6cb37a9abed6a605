/* SPDX-License-Identifier: MIT */
/*
 * Gradient drive of a ball joint: energy, torque, stiffness and damping, to be copied into a simulator.
 *
 * A rotation is a unit quaternion (x, y, z, w) of the body in its parent; only its direction counts. Torque, stiffness
 * and damping are in the axes of the body, as the rates of a ball joint are. Matrices are row-major. K [N m/rad] is
 * the stiffness at the target in the axes of the target; its symmetric part 0.5 (K + K^T) is used. With the rotation from the target to the body, an
 * angle a about the axis u, the energies are
 *
 *     DRIVE_TRACE   (1 - cos a) u^T K u      smooth everywhere; the torque falls to zero at a half turn
 *     DRIVE_LOG     (a^2 / 2) u^T K u        does not soften; the torque jumps at a half turn. With K = k I and turns
 *                                            about the axis of the target: three position drives of the gain k
 *
 * The torque is minus the gradient of the energy: no closed motion gains energy. K times the difference of two rotation
 * vectors is no gradient, and flutters. NaN in gives NaN out, as does a quaternion of zeros.
 */
#ifndef STIFFGEN_DRIVE_H
#define STIFFGEN_DRIVE_H

#include <math.h>

enum { DRIVE_TRACE = 0, DRIVE_LOG = 1 };

/* Rotation from the target: half an angle as quaternion (eta, eps), eta >= 0, and what the energy makes of it. */
typedef struct drive_state {
    double eta, eps[3];
    double g, dg, ddg; /* energy g eps^T K eps, and derivatives of g with respect to eta */
    double K[9];       /* symmetric part of the stiffness */
    double k[3];       /* K eps */
    double n[3];       /* eta k + k x eps */
    double share;      /* eps^T K eps */
} drive_state;

/*
 * Evaluate the deflection (eta, eps) of the target to the body, the energy's factor g(eta) with derivatives, and the
 * terms that energy, torque and stiffness share.
 */
static inline drive_state drive_evaluate(const double rotation[4], const double target[4], const double K[9], int form)
{
    const double *const a = target, *const b = rotation;
    drive_state s;
    double eps[3] = {a[3] * b[0] - b[3] * a[0] - a[1] * b[2] + a[2] * b[1],
                     a[3] * b[1] - b[3] * a[1] - a[2] * b[0] + a[0] * b[2],
                     a[3] * b[2] - b[3] * a[2] - a[0] * b[1] + a[1] * b[0]};
    const double eta = a[3] * b[3] + a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const double length = sqrt(eta * eta + eps[0] * eps[0] + eps[1] * eps[1] + eps[2] * eps[2]);
    const double scale = (eta < 0.0 ? -1.0 : 1.0) / length;
    s.eta = scale * eta;
    for (int i = 0; i < 3; ++i) { s.eps[i] = scale * eps[i]; }
    s.g = 2.0;
    s.dg = s.ddg = 0.0;
    if (form == DRIVE_LOG) { /* g = 2 h^2, h the half angle over its sine */
        const double x = s.eps[0] * s.eps[0] + s.eps[1] * s.eps[1] + s.eps[2] * s.eps[2];
        double h, dh, ddh;
        if (x < 1e-4) {      /* series in x; the first term left out is below 1e-17 */
            h = 1.0 + x * (1.0 / 6.0 + x * (3.0 / 40.0 + x * (15.0 / 336.0)));
            const double slope = 1.0 / 6.0 + x * (6.0 / 40.0 + x * (45.0 / 336.0));
            dh = -2.0 * s.eta * slope;
            ddh = 4.0 * s.eta * s.eta * (6.0 / 40.0 + x * (90.0 / 336.0)) - 2.0 * slope;
        } else {
            const double sine = sqrt(x);
            h = atan2(sine, s.eta) / sine;
            dh = (s.eta * h - 1.0) / x;
            ddh = (h + 3.0 * s.eta * dh) / x;
        }
        s.g = 2.0 * h * h;
        s.dg = 4.0 * h * dh;
        s.ddg = 4.0 * (dh * dh + h * ddh);
    }
    for (int i = 0; i < 9; ++i) { s.K[i] = 0.5 * (K[i] + K[i % 3 * 3 + i / 3]); }
    for (int i = 0; i < 3; ++i) {
        s.k[i] = s.K[3 * i] * s.eps[0] + s.K[3 * i + 1] * s.eps[1] + s.K[3 * i + 2] * s.eps[2];
    }
    s.share = s.eps[0] * s.k[0] + s.eps[1] * s.k[1] + s.eps[2] * s.k[2];
    for (int i = 0; i < 3; ++i) {
        const int j = (i + 1) % 3, l = (i + 2) % 3;
        s.n[i] = s.eta * s.k[i] + s.k[j] * s.eps[l] - s.k[l] * s.eps[j];
    }
    return s;
}

/* Energy [J], zero at the target. */
static inline double drive_energy(const double rotation[4], const double target[4], const double K[9], int form)
{
    const drive_state s = drive_evaluate(rotation, target, K, form);
    return s.g * s.share;
}

/* Torque [N m] of the drive on the body: minus the gradient of the energy. */
static inline void drive_torque(const double rotation[4], const double target[4], const double K[9], int form,
                                double torque[3])
{
    const drive_state s = drive_evaluate(rotation, target, K, form);
    for (int i = 0; i < 3; ++i) { torque[i] = 0.5 * s.share * s.dg * s.eps[i] - s.g * s.n[i]; }
}

/* Stiffness [N m/rad]: second derivative of the energy along turns about fixed axes, symmetric. */
static inline void drive_stiffness(const double rotation[4], const double target[4], const double K[9], int form,
                                   double stiffness[9])
{
    const drive_state s = drive_evaluate(rotation, target, K, form);
    /* Under a turn w in the body's axes: eps' = T w / 2. */
    const double T[9] = {s.eta, -s.eps[2], s.eps[1], s.eps[2], s.eta, -s.eps[0], -s.eps[1], s.eps[0], s.eta};
    const double across = 0.25 * s.share * (s.eta * s.dg + 2.0 * s.g), bent = 0.25 * s.share * s.ddg;
    double KT[9];
    for (int i = 0; i < 9; ++i) {
        const double *const row = s.K + i / 3 * 3;
        KT[i] = row[0] * T[i % 3] + row[1] * T[3 + i % 3] + row[2] * T[6 + i % 3];
    }
    for (int i = 0; i < 3; ++i) {
        for (int j = i; j < 3; ++j) {
            const double turned = T[i] * KT[j] + T[3 + i] * KT[3 + j] + T[6 + i] * KT[6 + j];
            stiffness[3 * i + j] = stiffness[3 * j + i] =
                0.5 * s.g * turned + bent * s.eps[i] * s.eps[j] - 0.5 * s.dg * (s.eps[i] * s.n[j] + s.eps[j] * s.n[i])
                - (i == j ? across : 0.0);
        }
    }
}

/* Turn two axes of a symmetric matrix A so that A[p][q] becomes zero, and the rows of V with them (Jacobi). */
static inline void drive_turn(int p, int q, double A[9], double V[9])
{
    const double beside = A[3 * p + q];
    if (beside == 0.0) { return; }
    /* Cotangent of twice the angle; t, c, sine: tangent, cosine and sine of the smaller of both solutions. */
    const double ratio = 0.5 * (A[4 * q] - A[4 * p]) / beside;
    const double t = (ratio < 0.0 ? -1.0 : 1.0) / (fabs(ratio) + sqrt(ratio * ratio + 1.0));
    const double c = 1.0 / sqrt(t * t + 1.0), sine = t * c;
    for (int k = 0; k < 3; ++k) {
        const double a = A[3 * p + k], b = A[3 * q + k], v = V[3 * p + k], w = V[3 * q + k];
        A[3 * p + k] = c * a - sine * b;
        A[3 * q + k] = sine * a + c * b;
        V[3 * p + k] = c * v - sine * w;
        V[3 * q + k] = sine * v + c * w;
    }
    for (int k = 0; k < 3; ++k) {
        const double a = A[3 * k + p], b = A[3 * k + q];
        A[3 * k + p] = c * a - sine * b;
        A[3 * k + q] = sine * a + c * b;
    }
}

/*
 * Damping [N m s/rad] with which every mode of a stiffness and an inertia [kg m^2] (both in the axes of the
 * body; of the stiffness the symmetric part is used, the inertia is symmetric and positive definite) has a damping
 * ratio; 1 is critical. A mode of negative stiffness has the damping
 * of its absolute value: call it with drive_stiffness for a damping that follows the deflection.
 */
static inline void drive_damping(const double stiffness[9], const double inertia[9], double ratio, double damping[9])
{
    const double *const M = inertia;
    double L[9] = {0.0}, A[9], V[9] = {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0};
    L[0] = sqrt(M[0]);
    L[3] = M[3] / L[0];
    L[4] = sqrt(M[4] - L[3] * L[3]);
    L[6] = M[6] / L[0];
    L[7] = (M[7] - L[6] * L[3]) / L[4];
    L[8] = sqrt(M[8] - L[6] * L[6] - L[7] * L[7]);
    for (int i = 0; i < 9; ++i) { A[i] = 0.5 * (stiffness[i] + stiffness[i % 3 * 3 + i / 3]); }
    for (int side = 0; side < 2; ++side) { /* A = L^-1 A, transposed, twice: L^-1 stiffness L^-T */
        double B[9];
        for (int j = 0; j < 3; ++j) {
            B[3 * j] = A[j] / L[0];
            B[3 * j + 1] = (A[3 + j] - L[3] * B[3 * j]) / L[4];
            B[3 * j + 2] = (A[6 + j] - L[6] * B[3 * j] - L[7] * B[3 * j + 1]) / L[8];
        }
        for (int i = 0; i < 9; ++i) { A[i] = B[i]; }
    }
    for (int sweep = 0; sweep < 8; ++sweep) { /* five suffice for a 3 x 3 matrix in double precision */
        drive_turn(0, 1, A, V);
        drive_turn(0, 2, A, V);
        drive_turn(1, 2, A, V);
    }
    for (int k = 0; k < 3; ++k) { /* rows of V become L v */
        double *const v = V + 3 * k;
        v[2] = L[6] * v[0] + L[7] * v[1] + L[8] * v[2];
        v[1] = L[3] * v[0] + L[4] * v[1];
        v[0] = L[0] * v[0];
    }
    for (int i = 0; i < 9; ++i) {
        damping[i] = 0.0;
        for (int k = 0; k < 3; ++k) {
            damping[i] += 2.0 * ratio * sqrt(fabs(A[4 * k])) * V[3 * k + i / 3] * V[3 * k + i % 3];
        }
    }
}

#endif
