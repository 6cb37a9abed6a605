/* Damping: designed from the springs' tangent, limited by the sample time. */
#include "impedance.h"

/* Share of its cap that damping has where the account began beyond a limit: units may be mistaken, and 57 times as
 * large a velocity must not make the arm oscillate. */
static const double DOUBTED_SHARE = 1.0 / 64.0;
static const double FLAT_TWISTS = 3e-2; /* regularisation of the twists that dr follows, over their squares' sum */
static const double LEAST_DAMPED = 1e-9; /* added to B for its inverse, over its largest entry */
static const double BRAKED = 0.9; /* share of the velocity limits from which on a joint is braked */

/*
 * Compute the inertia that each joint has alone, 1 / (M^-1)_ii, from modes v with v . M v = 1: M^-1 is the sum of
 * v v^T. Return the trace of M^-1: joint_damping I has no eigenvalue above trace times joint_damping with respect to M.
 */
static double reduce_inertia(const double *modes, double *inertia)
{
    double squares[N] = {0.0}, trace = 0.0;
    for (int k = 0; k < N; ++k) {
        for (int i = 0; i < N; ++i) {
            squares[i] += modes[k * N + i] * modes[k * N + i];
        }
    }
    for (int i = 0; i < N; ++i) {
        inertia[i] = 1.0 / squares[i];
        trace += squares[i];
    }
    return trace;
}

/*
 * Compute the modes of the springs' tangent. They are refined from the extrapolation of the last three designs' modes;
 * where these are too far away, or two eigenvalues are close, they are solved anew. The result is the same up to
 * rounding. Return whether there are modes: M is positive definite.
 */
static int find_modes(step_t *s)
{
    output_t *const out = s->out;
    double *const modes = s->modes, *const before = modes + NN, *const oldest = s->scratch + 2 * NN;
    for (int k = 0; k < NN; ++k) { /* extrapolate the parabola through the last three, and shift them by one */
        const double last = modes[k];
        modes[k] = 3.0 * (last - before[k]) + oldest[k];
        oldest[k] = before[k];
        before[k] = last;
    }
    if (refine_modes(N, out->joint_stiffness, out->mass_matrix, s->scratch, out->eigenvalues, modes)) {
        return 1;
    }
    const int error = solve_modes(N, out->joint_stiffness, out->mass_matrix, s->scratch, out->eigenvalues, modes);
    memcpy(before, modes, NN * sizeof(double));
    memcpy(oldest, modes, NN * sizeof(double));
    return error == 0;
}

/*
 * Measure the inertia at q that bounds the limit avoidance of each joint beside that of all others: 1 / sum_j
 * |(M^-1)_ij|; no bound if M is not positive.
 */
void measure_inertia(step_t *s, const double *q)
{
    double *const M = s->scratch, *const L = M + NN;
    compute_inertia(s->c, s->m, q, M);
    for (int i = 0; i < N; ++i) {
        s->m->inertia[i] = DBL_MAX;
    }
    const double mass = largest_diagonal(N, M);
    if (factorise_cholesky(N, M, mass, 0.0, L) != 0) { /* L L^T = M / mass */
        return;
    }
    for (int i = 0; i < N; ++i) {
        double column[N] = {0.0}, sum = 0.0; /* of mass M^-1 */
        column[i] = 1.0;
        solve_forward(N, L, column);
        solve_backward(N, L, column);
        for (int j = 0; j < N; ++j) {
            sum += fabs(column[j]);
        }
        s->m->inertia[i] = mass / sum;
    }
}

/*
 * Compute the damping b of each mode with stiffness lambda. b is 2 zeta sqrt(l), l = |lambda| (a mode with negative
 * stiffness, which falls, then falls slowly), where nothing is late. Held torque and delay act late by h = (delay +
 * 1/2) T, the damping by the delay of the smoothed velocity more, g = h + delay: the stiffness takes l h of damping
 * away, the damping b g of inertia, so zeta = (b - l h) / (2 sqrt(l (1 - b g))) is solved for b.
 */
static void damp_modes(const config_t *c, const memory_t *m, const double *eigenvalues, double scale, double *b)
{
    for (int k = 0; k < N; ++k) {
        const double l = fabs(eigenvalues[k]) * scale, late = (c->delay_samples + 0.5) * c->sample_time;
        const double zeta = c->damping_ratio[k], later = late + find_velocity_delay(c, m);
        const double p = l * (2.0 * zeta * zeta * later - late);
        /* the larger root of b^2 + 2 p b + l^2 late^2 - 4 zeta^2 l = 0, and no less than l late, where zeta is 0 */
        b[k] = larger(sqrt(larger(p * p + 4.0 * zeta * zeta * l - l * l * late * late, 0.0)) - p, l * late);
    }
}

/* Use the joint damping d I alone, and no brake: the damping of the output is 0 until now. Return the scale 1. */
static double damp_joints_only(step_t *s, double d)
{
    memset(s->brake, 0, sizeof s->brake);
    for (int i = 0; i < N; ++i) {
        s->out->damping[i * (N + 1)] = d;
    }
    return 1.0;
}

/*
 * Return the largest scale of the springs that largest_eigenvalue allows for the stiffest mode, 1 at most. The
 * eigenvalues in the output are those of find_modes.
 */
static double cap_scale(step_t *s)
{
    const double stiffest = s->out->eigenvalues[N - 1], most = largest_eigenvalue(s->c, s->m);
    if (!(stiffest > most)) {
        return 1.0;
    }
    s->status |= ID(STATUS_STIFFNESS_CAPPED);
    s->m->capped = 1; /* cap_springs looks at the springs from the next step on */
    return most / stiffest;
}

/*
 * Design the damping B = M V diag(b) V^T M + d I with Kq v = lambda M v, V^T M V = I (Albu-Schaeffer and others 2003).
 * It is capped: no eigenvalue of M^-1 B is above that of largest_damping, of which the joint damping d has at most
 * half, the modes' b what d leaves, and the brake what the largest b leaves. Return the scale of cap_scale.
 */
double design_damping(step_t *s)
{
    const config_t *const c = s->c;
    output_t *const out = s->out;
    double *const rows = s->scratch;
    const double *const modes = s->modes;
    double b[N], largest_b = 0.0, d = c->joint_damping;
    const double most = largest_damping(c, s->m);
    if (!find_modes(s)) {
        s->status |= ID(STATUS_MASS_MATRIX);
        memset(out->eigenvalues, 0, sizeof out->eigenvalues);
        return damp_joints_only(s, d);
    }
    const double trace = reduce_inertia(modes, s->brake);
    if (s->m->doubted) {
        return damp_joints_only(s, smaller(d, DOUBTED_SHARE * 0.5 * most / trace));
    }
    s->status |= out->eigenvalues[0] < 0.0 ? (uint32_t)ID(STATUS_INDEFINITE) : 0u;
    const double scale = cap_scale(s);
    if (d * trace > 0.5 * most) {
        d = 0.5 * most / trace;
        s->status |= ID(STATUS_DAMPING_CAPPED);
    }
    damp_modes(c, s->m, out->eigenvalues, scale, b);
    const double most_b = most - d * trace;
    int capped = 0;
    for (int k = 0; k < N; ++k) {
        capped |= b[k] > most_b;
        b[k] = clamp(b[k], 0.0, most_b);
        largest_b = larger(largest_b, b[k]);
    }
    s->status |= capped ? (uint32_t)ID(STATUS_DAMPING_CAPPED) : 0u;
    multiply_rows(N, modes, out->mass_matrix, rows);
    form_congruence(N, N, rows, b, out->damping);
    for (int i = 0; i < N; ++i) {
        s->brake[i] *= most_b - largest_b;
        out->damping[i * (N + 1)] += d;
    }
    return scale;
}

/*
 * Compute X = L^-1 J^T diag(weights) of the tips' J: one row per joint. Linear and angular rows of J weigh alike: over
 * all tips, the entries of X of either kind have the sum of squares 1.
 */
static void weigh_twists(const double *L, const double *J, double *X, double *weights)
{
    double squares[TIP_ROWS] = {0.0}, sums[2] = {0.0}; /* of the linear rows of J, of the angular ones */
    transpose(TIP_ROWS, N, J, X);
    solve_rows(N, TIP_ROWS, L, X);
    for (int i = 0; i < N; ++i) {
        for (int r = 0; r < TIP_ROWS; ++r) {
            squares[r] += X[i * TIP_ROWS + r] * X[i * TIP_ROWS + r];
        }
    }
    for (int r = 0; r < TIP_ROWS; ++r) {
        sums[r % 6 / 3] += squares[r];
    }
    for (int r = 0; r < TIP_ROWS; ++r) {
        const double sum = sums[r % 6 / 3];
        weights[r] = sum > DBL_MIN ? 1.0 / sqrt(sum) : 0.0; /* 0 where no joint moves them */
    }
    scale_columns(N, TIP_ROWS, weights, X);
}

/*
 * Compute dr, the joint velocity of the equilibrium's twists: among all with these twists the one with the least dr . B
 * dr, by damped least squares. B dr then is J^T f: it acts at the tips alone, and a tip that is clamped does not drive
 * the self-motion. Where a joint would exceed its limit, near singular postures, more regularisation takes the velocity
 * of the weak modes away and leaves the strong ones.
 */
void follow_twists(step_t *s, const double *twists, double *velocity)
{
    double *const L = s->scratch;
    double X[N * TIP_ROWS] = {0.0}, G[TIP_ROWS * TIP_ROWS] = {0.0}, weights[TIP_ROWS] = {0.0}, f[TIP_ROWS] = {0.0};
    double excess = HUGE_VAL;
    const double *const limits = s->c->reference_velocity_limit;
    memset(velocity, 0, N * sizeof(double));
    /* L L^T is B over its largest entry, and with y = L^T dr the least dr . B dr is the least |y|^2 */
    if (factorise_cholesky(N, s->out->damping, largest_diagonal(N, s->out->damping), LEAST_DAMPED, L) != 0) {
        return;
    }
    weigh_twists(L, find_jacobians(s), X, weights);
    multiply_transposed(N, TIP_ROWS, X, G);
    double shift = FLAT_TWISTS; /* y = X f, (X^T X + shift I) f = the weighted twists */
    for (int attempt = 0; attempt < 4 && excess > 1.0; ++attempt) {
        for (int r = 0; r < TIP_ROWS; ++r) {
            f[r] = weights[r] * twists[r];
        }
        if (!solve_damped(TIP_ROWS, G, shift, f)) {
            memset(velocity, 0, N * sizeof(double));
            return;
        }
        for (int i = 0; i < N; ++i) {
            velocity[i] = dot(TIP_ROWS, X + i * TIP_ROWS, f);
        }
        solve_backward(N, L, velocity);
        excess = 0.0;
        for (int i = 0; i < N; ++i) {
            excess = larger(excess, fabs(velocity[i]) / limits[i]);
        }
        shift *= 10.0;
    }
    for (int i = 0; i < N; ++i) {
        velocity[i] /= larger(excess, 1.0);
    }
}

/*
 * Choose of how many samples the velocity is the mean. One quantum of position in a differenced velocity is a torque of
 * B quantum / T, and a mean of k samples divides it by k. Where the torque exceeds the rate, what one call may change,
 * the damping would be lost. The next design's B has the delay of this mean: with one sample less it is no larger than
 * (k + 1) / k times this one, so that a mean that is shortened is not too short in the step after.
 */
static void choose_mean(step_t *s)
{
    memory_t *const m = s->m;
    const double k = 1.0 + m->averaged;
    double needed = 1.0;
    for (int i = 0; s->c->position_quantum > 0.0 && i < N; ++i) {
        double torque = 0.0;
        for (int j = 0; j < N; ++j) {
            torque += fabs(s->out->damping[i * N + j]) * s->c->position_quantum / s->c->sample_time;
        }
        needed = fmax(needed, torque / m->rate[i]);
    }
    if (needed > k && m->averaged < RECENT - 1) { /* by one: the longer mean already lowers B */
        m->averaged += 1;
    } else if (m->averaged > 0 && needed * (k + 1.0) <= k * (k - 1.0)) {
        m->averaged -= 1;
    }
}

/* Pass the velocity through the low pass of velocity_filter_time, which starts anew after a gap. */
static void pass_low(step_t *s)
{
    memory_t *const m = s->m;
    const double T = s->c->sample_time, passed_share = T / (T + s->c->velocity_filter_time);
    for (int i = 0; i < N; ++i) {
        const double behind = m->recent_count > 1 ? (1.0 - passed_share) * (m->filtered[i] - s->velocity[i]) : 0.0;
        s->velocity[i] += behind;
        m->filtered[i] = s->velocity[i];
    }
}

/* Smooth the velocity that the damping uses: a mean against quanta of position, then the low pass. */
void smooth_velocity(step_t *s)
{
    const memory_t *const m = s->m;
    choose_mean(s);
    const int wanted = 1 + m->averaged, count = wanted < m->recent_count ? wanted : m->recent_count;
    s->out->velocity_samples = (double)count;
    for (int i = 0; count > 1 && i < N; ++i) {
        double sum = 0.0;
        for (int k = 0; k < count; ++k) {
            sum += m->recent[k * N + i];
        }
        s->velocity[i] = sum / count;
    }
    pass_low(s);
}

/*
 * Brake a joint that is faster than its reference may be, as hard as the sample time allows: modes of different
 * stiffness end a ramp at different times, and near a singularity a small tip motion needs a large joint motion.
 * `brake` is what one joint may have; several fast joints share it.
 */
void brake_fast_joints(step_t *s)
{
    double excess[N];
    int fast = 0;
    for (int i = 0; i < N; ++i) {
        const double limit = BRAKED * s->c->reference_velocity_limit[i];
        excess[i] = s->velocity[i] - clamp(s->velocity[i], -limit, limit);
        fast += excess[i] != 0.0;
    }
    for (int i = 0; i < N; ++i) {
        s->out->damping_torque[i] -= excess[i] != 0.0 ? s->brake[i] * excess[i] / fast : 0.0;
    }
}
