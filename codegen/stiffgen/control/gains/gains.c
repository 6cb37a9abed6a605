/*
 * Gains for motors with a controller inside, which apply tau_ff + kp (q_des - q) + kd (dq_des - dq) at their own rate.
 * kp and kd are the diagonals of stiffness and damping within bounds, the diagonal matrices nearest to both; tau_ff has
 * what is not diagonal.
 */
#include "gains.h"

static int is_finite(const double *x, int count) { return doubles_within(x, (size_t)count, -DBL_MAX, DBL_MAX); }
static int is_limit(const double *x) { return doubles_within(x, N, 0.0, HUGE_VAL); }

/*
 * Split a torque at (q, dq) [N m] into tau_ff and diagonal gains, those of the motors' own loop: the nearest ones to
 * joint_stiffness and damping (N x N) that lie between 0 and the limits. All results are NaN if a number is not finite.
 */
int split_torque(const double *q, const double *dq, const double *q_des, const double *dq_des, const double *torque,
                 const double *joint_stiffness, const double *damping, const double *kp_limit, const double *kd_limit,
                 double *tau_ff, double *kp, double *kd)
{
    int good = is_finite(q, N) && is_finite(dq, N) && is_finite(q_des, N) && is_finite(dq_des, N);
    good = good && is_finite(torque, N) && is_finite(joint_stiffness, N * N) && is_finite(damping, N * N);
    good = good && is_limit(kp_limit) && is_limit(kd_limit);
    for (int i = 0; i < N; ++i) {
        const int diagonal = i * (N + 1);
        kp[i] = clamp(joint_stiffness[diagonal], 0.0, kp_limit[i]);
        kd[i] = clamp(damping[diagonal], 0.0, kd_limit[i]);
        tau_ff[i] = torque[i] - kp[i] * (q_des[i] - q[i]) - kd[i] * (dq_des[i] - dq[i]); /* what their loop lacks */
        good = good && fabs(tau_ff[i]) <= DBL_MAX;
    }
    for (int i = 0; i < N && !good; ++i) {
        tau_ff[i] = kp[i] = kd[i] = (double)NAN;
    }
    return good ? ID(GAINS_OK) : ID(GAINS_E_NUMBER);
}

/*
 * Bound the work [J] that a motor puts out within the time `hold` after the sample, whatever the environment does, from
 * its torque at the sample's position at rest. At the distance x [rad] the work is at most
 *     torque x - kp x^2 / 2 - kd x^2 / hold = (torque - c x) x,
 * since the integral of dq^2 over at most `hold` is at least x^2 / hold (Cauchy and Schwarz). The bound is the largest
 * value for |x| <= speed hold, as no joint is faster than `speed`; a motion at constant speed attains it.
 */
static double bound_motor_work(double torque, double kp, double kd, double speed, double hold)
{
    const double most = fabs(torque), c = 0.5 * kp + kd / hold, farthest = speed * hold;
    const double x = 2.0 * c * farthest > most ? most / (2.0 * c) : farthest; /* where the derivative is 0, if so far */
    return (most - c * x) * x;
}

/* Bound the work of all motors within `hold` after the sample. */
double work_of_late_host(const double *q, const double *q_des, const double *dq_des, const double *tau_ff,
                         const double *kp, const double *kd, const double *velocity_limit, double hold)
{
    double work = 0.0;
    for (int i = 0; i < N; ++i) {
        const double at_rest = tau_ff[i] + kp[i] * (q_des[i] - q[i]) + kd[i] * dq_des[i], speed = velocity_limit[i];
        const int good = fabs(at_rest) <= DBL_MAX && kp[i] >= 0.0 && kd[i] >= 0.0 && speed >= 0.0 && hold > 0.0;
        const double most = good ? bound_motor_work(at_rest, kp[i], kd[i], speed, hold) : (double)NAN;
        work += fabs(most) <= DBL_MAX ? most : (double)NAN;
    }
    return work;
}
