/*
 * Gains for motors with a controller inside, which apply tau_ff + kp (q_des - q) + kd (dq_des - dq) at their own rate.
 * kp and kd are the diagonals of stiffness and damping within bounds, the diagonal matrices nearest to both; tau_ff has
 * what is not diagonal.
 */
#include "gains.h"

/*
 * Split a torque at (q, dq) [N m] into tau_ff and diagonal gains, those of the motors' own loop: the nearest ones to
 * joint_stiffness and damping (N x N) that lie between 0 and the limits. All results are NaN if a number is not finite.
 */
int split_torque(const double *q, const double *dq, const double *q_des, const double *dq_des, const double *torque,
                 const double *joint_stiffness, const double *damping, const double *kp_limit, const double *kd_limit,
                 double *tau_ff, double *kp, double *kd)
{
    const double *const vectors[5] = {q, dq, q_des, dq_des, torque};
    const double *const others[7] = {joint_stiffness, damping, kp_limit, kd_limit, tau_ff, kp, kd};
    for (int k = 0; k < 7; ++k) {
        if (others[k] == NULL || vectors[k < 5 ? k : 0] == NULL) {
            return ID(GAINS_E_NULL);
        }
    }
    int good = doubles_within(kp_limit, N, 0.0, HUGE_VAL) && doubles_within(kd_limit, N, 0.0, HUGE_VAL);
    good = good && doubles_within(joint_stiffness, N * N, -DBL_MAX, DBL_MAX);
    good = good && doubles_within(damping, N * N, -DBL_MAX, DBL_MAX);
    for (int k = 0; k < 5; ++k) {
        good = good && doubles_within(vectors[k], N, -DBL_MAX, DBL_MAX);
    }
    for (int i = 0; i < N; ++i) {
        /* The nearest diagonal has the matrix's own entries; tau_ff is what the motors' loop then lacks. */
        kp[i] = clamp(joint_stiffness[i * (N + 1)], 0.0, kp_limit[i]);
        kd[i] = clamp(damping[i * (N + 1)], 0.0, kd_limit[i]);
        tau_ff[i] = torque[i] - kp[i] * (q_des[i] - q[i]) - kd[i] * (dq_des[i] - dq[i]);
        good = good && fabs(tau_ff[i]) <= DBL_MAX;
    }
    for (int i = 0; i < N && !good; ++i) {
        tau_ff[i] = kp[i] = kd[i] = (double)NAN;
    }
    return good ? ID(GAINS_OK) : ID(GAINS_E_NUMBER);
}

/*
 * Bound the work that a motor puts out within the time `hold` after the sample, whatever the environment does, with a
 * the torque of the motor at the sample's position at rest, and no joint faster than `speed`. At the distance x the
 * work is at most a x - kp x^2 / 2 - kd x^2 / hold, since the integral of dq^2 over at most `hold` is at least x^2 /
 * hold (Cauchy and Schwarz). The bound is the largest value for |x| <= speed hold; a motion at constant speed attains
 * it.
 */
static double bound_motor_work(double a, double kp, double kd, double speed, double hold)
{
    const double c = 0.5 * kp + kd / hold, far = speed * hold;
    const double x = 2.0 * c * far > fabs(a) ? fabs(a) / (2.0 * c) : far;
    return (fabs(a) - c * x) * x;
}

/* Bound the work of all motors within `hold` after the sample. */
double work_of_late_host(const double *q, const double *q_des, const double *dq_des, const double *tau_ff,
                         const double *kp, const double *kd, const double *velocity_limit, double hold)
{
    const double *const vectors[7] = {q, q_des, dq_des, tau_ff, kp, kd, velocity_limit};
    double work = 0.0;
    for (int k = 0; k < 7; ++k) {
        if (vectors[k] == NULL) {
            return (double)NAN;
        }
    }
    for (int i = 0; i < N; ++i) {
        const double at_rest = tau_ff[i] + kp[i] * (q_des[i] - q[i]) + kd[i] * dq_des[i], speed = velocity_limit[i];
        const int good = fabs(at_rest) <= DBL_MAX && kp[i] >= 0.0 && kd[i] >= 0.0 && speed >= 0.0 && hold > 0.0;
        const double most = good ? bound_motor_work(at_rest, kp[i], kd[i], speed, hold) : (double)NAN;
        work += fabs(most) <= DBL_MAX ? most : (double)NAN;
    }
    return work;
}
