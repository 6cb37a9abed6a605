/* Decay of the tip's speed under the controller's damping: the one number that tunes integrals on any arm. */
#include "settle.h"

/* Return v . K v for a vector v in base axes. turns: K (3 x 3) is in the axes of a pose, R^T v takes the place of v. */
double square_in(const double *K, int turns, const double *pose, const double *v)
{
    double sum = 0.0, own[3];
    for (int i = 0; i < 3; ++i) {
        own[i] = turns ? pose[i] * v[0] + pose[4 + i] * v[1] + pose[8 + i] * v[2] : v[i];
    }
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            sum += own[i] * K[3 * i + j] * own[j];
        }
    }
    return sum;
}

/* Return v . K v for a twist or wrench, with the springs of translation and rotation. */
static double spring_of(const double *Kt, const double *Ko, const double *pose, const double *v)
{
    return square_in(Kt, TRANSLATION_TURNS, pose, v) + square_in(Ko, ROTATION_TURNS, pose, v + 3);
}

/* Compute x = M^-1 J^T F, the joints' acceleration by a wrench F at rest; M has the motors' inertia. */
static void accelerate(const controller_t *c, const double *q, const double *J, const double *wrench, double *x)
{
    double mass[N * N], L[N * N];
    stiffgen_mass_matrix(q, mass);
    for (int i = 0; i < N; ++i) {
        mass[i * (N + 1)] += c->motor_inertia[i];
        x[i] = 0.0;
        for (int k = 0; k < 6; ++k) {
            x[i] += J[k * N + i] * wrench[k];
        }
    }
    find_triangle(N, mass, L);
    solve_triangles(N, L, x);
}

/*
 * Return the rate [1/s] at which the speed decays that a wrench F, here a unit vector, gives the tip: with the joints'
 * x = M^-1 J^T F it is (x . B x) / (x . M x). B damps each mode of eigenvalue l by b(l), and joints by JOINT_DAMPING;
 * here b is taken at the mean eigenvalue (x . K x) / (x . M x), which is 4 % too much in the mean, and at most 22 % in
 * 1200 draws of an iiwa 14. stiffness: of the springs along the wrench.
 */
double find_decay(const controller_t *c, const double *q, const double *Kt, const double *Ko, const double *wrench,
                  double *stiffness)
{
    double J[6 * N], x[N], twist[6], pose[16];
    stiffgen_poses(q, stiffgen_tool(c), pose);
    stiffgen_jacobians(q, stiffgen_tool(c), J);
    *stiffness = spring_of(Kt, Ko, pose, wrench);
    accelerate(c, q, J, wrench, x);
    for (int k = 0; k < 6; ++k) {
        twist[k] = dot(N, J + k * N, x);
    }
    const double inertia = dot(6, twist, wrench), T = c->sample_time; /* x . M x = J x . F */
    if (!(inertia > 0.0) || !all_finite(x, N)) { /* M is singular */
        return 0.0;
    }
    const double mean = larger(spring_of(Kt, Ko, pose, twist) / inertia, 0.0); /* [1/s^2] */
    const double damping = mode_damping(mean, (c->delay_samples + 0.5) * T, c->damping_ratio);
    return clamp(damping + JOINT_DAMPING * dot(N, x, x) / inertia, 0.0, most_damping(T, c->delay_samples));
}
