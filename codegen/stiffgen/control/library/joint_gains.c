/*
 * Gains for motors with a controller inside, which apply tau_ff + kp (q_des - q) + kd (dq_des - dq) at their own rate.
 * kp and kd are the diagonals of stiffness and damping within bounds, the diagonal matrices nearest to both; tau_ff has
 * what is not diagonal.
 */
#include "impedance.h"

static const double GAIN_FADE = 0.9; /* share of the motors' kp that is left after another call without a sample */

/* Choose gains: the diagonal of a matrix, each entry at least 0 and at most its limit. */
static void choose_gains(const double *matrix, const double *limit, double *gains)
{
    for (int i = 0; i < N; ++i) {
        gains[i] = clamp(matrix[i * (N + 1)], 0.0, limit[i]);
    }
}

/*
 * Split a torque at (q, dq) into tau_ff and gains. Arguments that are not finite, or a limit below 0, give NaN and an
 * error.
 */
int split_torque(const double *q, const double *dq, const double *q_des, const double *dq_des, const double *torque,
                 const double *joint_stiffness, const double *damping, const double *kp_limit, const double *kd_limit,
                 double *tau_ff, double *kp, double *kd)
{
    const double *const vectors[5] = {q, dq, q_des, dq_des, torque};
    int good = doubles_within(joint_stiffness, NN, -DBL_MAX, DBL_MAX) && doubles_within(damping, NN, -DBL_MAX, DBL_MAX);
    for (int k = 0; k < 5; ++k) {
        good = good && doubles_within(vectors[k], N, -DBL_MAX, DBL_MAX);
    }
    good = good && doubles_within(kp_limit, N, 0.0, HUGE_VAL) && doubles_within(kd_limit, N, 0.0, HUGE_VAL);
    choose_gains(joint_stiffness, kp_limit, kp);
    choose_gains(damping, kd_limit, kd);
    for (int i = 0; i < N; ++i) {
        tau_ff[i] = torque[i] - kp[i] * (q_des[i] - q[i]) - kd[i] * (dq_des[i] - dq[i]);
        good = good && fabs(tau_ff[i]) <= DBL_MAX;
    }
    for (int i = 0; i < N && !good; ++i) {
        tau_ff[i] = kp[i] = kd[i] = (double)NAN;
    }
    return good ? ID(OK) : ID(E_GAINS);
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

/* Bound the work of all motors within `hold` after the sample; NaN if an argument is not finite, or hold not above
 * 0. */
double bound_late_work(const double *q, const double *q_des, const double *dq_des, const double *tau_ff,
                       const double *kp, const double *kd, const double *speed, double hold)
{
    double work = 0.0;
    for (int i = 0; i < N; ++i) {
        const double at_rest = tau_ff[i] + kp[i] * (q_des[i] - q[i]) + kd[i] * dq_des[i];
        const int good = fabs(at_rest) <= DBL_MAX && kp[i] >= 0.0 && kd[i] >= 0.0 && speed[i] >= 0.0 && hold > 0.0;
        const double most = good ? bound_motor_work(at_rest, kp[i], kd[i], speed[i], hold) : (double)NAN;
        work += fabs(most) <= DBL_MAX ? most : (double)NAN;
    }
    return work;
}

/*
 * Plan the gains of a step: kp from the diagonal of the tangent, kd from that of the damping; 0 without
 * ACTUATION_GAINS. motor_damping, the torque of kd at the present velocity, is added to the torque that is held: with
 * what the motors do then, damping counts once.
 */
void plan_gains(step_t *s)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const int has_gains = c->actuation == ID(ACTUATION_GAINS) && m->fault != ID(FAULT_DISSIPATION);
    for (int i = 0; i < N; ++i) {
        const double tangent = s->out->joint_stiffness[i * (N + 1)], limit_slope = s->limit_slope[i];
        /* the tangent is the unscaled springs' and the limit avoidance's, which no scale weakens */
        const double wanted = m->scale * (tangent - limit_slope) + limit_slope;
        m->kp[i] = has_gains && wanted > 0.0 ? smaller(wanted, c->kp_limit[i]) : 0.0;
        m->kd[i] = has_gains ? clamp(s->out->damping[i * (N + 1)], 0.0, c->kd_limit[i]) : 0.0;
        s->motor_damping[i] = m->kd[i] * s->velocity[i];
    }
}

/*
 * Bound from below the work that the gains take in over the last interval, which no call was missing from: exact for
 * kp, whose spring was at rest at the interval's start; for kd the least that any motion with these ends dissipates in
 * a sample time. Gains go with no delay (validate).
 */
double absorbed_work(const memory_t *m, const double *motion)
{
    double work = 0.0;
    if (m->delay > 0) {
        return work;
    }
    for (int i = 0; i < N; ++i) {
        work += (0.5 * m->kp[i] + m->kd[i] / m->sample_time) * motion[i] * motion[i];
    }
    return work;
}

/* Fade the springs of the motors, which stay where they are without a sample. Falling gains put no energy out. */
void fade_gains(memory_t *m)
{
    for (int i = 0; i < N; ++i) {
        m->kp[i] *= GAIN_FADE;
    }
}

/*
 * Return the torque of motor i at the last known state, tau_ff - kd dq: kp adds none there. It is clamped to the effort
 * limit (0 if the configuration is refused), or to |tau_ff| if this is larger.
 */
static double apply_gains(const step_t *s, int i, double tau_ff, int refused)
{
    const double most = larger(refused ? 0.0 : s->c->effort_limit[i], fabs(tau_ff));
    return clamp(tau_ff - s->m->kd[i] * s->m->dq[i], -most, most);
}

/* Lower kd where its torque at the last known velocity would exceed the effort limit. */
void limit_gains(step_t *s, int refused)
{
    memory_t *const m = s->m;
    for (int i = 0; i < N; ++i) {
        const double tau_ff = s->out->torque[i], damping = m->kd[i] * m->dq[i];
        const double applied = apply_gains(s, i, tau_ff, refused);
        if (!(fabs(damping) <= DBL_MAX)) { /* the memory holds no velocity */
            m->kd[i] = 0.0;
        } else if (applied != tau_ff - damping) { /* clamped: kd dq becomes what is left of it */
            m->kd[i] *= (tau_ff - applied) / damping;
            s->status |= ID(STATUS_SATURATED);
        }
    }
}

/*
 * Report tau_ff, the torque that the motors apply at the last known state, and the work of a late call: as late as one
 * may be, `hold` calls with call_gap sample times each, or in a fault one.
 */
void report_gains(const step_t *s, int refused)
{
    const memory_t *const m = s->m;
    output_t *const out = s->out;
    memcpy(out->tau_ff, out->torque, sizeof out->tau_ff);
    for (int i = 0; i < N; ++i) {
        const double applied = apply_gains(s, i, out->tau_ff[i], refused);
        out->torque[i] = fabs(applied) <= DBL_MAX ? applied : out->tau_ff[i];
    }
    const double hold = m->fault == ID(FAULT_NONE) ? (double)m->hold * m->call_gap : (double)m->call_gap;
    out->late_work = m->known ? bound_late_work(m->q, m->q, out->dq_des, out->tau_ff, m->kp, m->kd, m->velocity_limit,
                                                hold * m->sample_time) : 0.0;
}
