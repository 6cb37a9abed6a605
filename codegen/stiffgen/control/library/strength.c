/* Strength: the tank that a wrench at the tip needs, and the wrench that the tank allows. */
#include "impedance.h"

static const double NO_STIFFNESS = 1e-9; /* [N/m] or [N m/rad] in place of none, where it is divided by */
static const double LARGEST_ENERGY = 1e4; /* [J] largest energy limit */

/*
 * Return number k of joint i in [0, 1): bits of k and i, mixed until no relation is left (finaliser of MurmurHash3, A.
 * Appleby, public domain). Multiples of one number, or of roots, would keep the joints near a curve or a surface.
 */
double spread_joint(int k, int i)
{
    uint32_t bits = ((uint32_t)k << 8) + (uint32_t)i + 1u;
    bits = (bits ^ (bits >> 16)) * 0x85ebca6bu;
    bits = (bits ^ (bits >> 13)) * 0xc2b2ae35u;
    return (double)(bits ^ (bits >> 16)) / 4294967296.0; /* 2^32 */
}

/* Choose one of POSTURES postures, spread over the position limits (half a turn where there is none). */
void place_posture(const config_t *c, const memory_t *m, int k, double *q)
{
    for (int i = 0; i < N; ++i) {
        const double low = larger(c->lower_limit[i], smaller(c->upper_limit[i], HALF_TURN) - 2.0 * HALF_TURN);
        const double high = smaller(c->upper_limit[i], low + 2.0 * HALF_TURN);
        q[i] = low + (high - low) * spread_joint(k + 1, i);
    }
    stiffgen_retract(m, q);
}

/* Write the poses of tools that are none: the tips themselves. */
void place_no_tools(double *tool)
{
    memset(tool, 0, 16 * TIPS * sizeof(double));
    for (int k = 0; k < 4 * TIPS; ++k) {
        tool[16 * (k / 4) + 5 * (k % 4)] = 1.0;
    }
}

/* Return the largest eigenvalue of W diag(weights) W^T, W of 3 or 6 rows over the joints; weights: at least 0. */
static double bound_quadratic(int rows, const double *W, const double *weights)
{
    double A[36], d[6] = {0.0}, weighted[N];
    for (int k = 0; k < rows; ++k) {
        for (int i = 0; i < N; ++i) {
            weighted[i] = weights[i] * W[k * N + i];
        }
        for (int j = 0; j <= k; ++j) {
            A[k * rows + j] = A[j * rows + k] = dot(N, weighted, W + j * N);
        }
    }
    if (rows == 3) {
        return larger(find_largest_eigenvalue(A), 0.0);
    }
    (void)diagonalise_symmetric(rows, A, d, NULL);
    return larger(d[rows - 1], 0.0);
}

/*
 * Bound the reserve of the torques J^T w of all w with |w_k / size_k| <= 1 (2-norm) in `rows` directions, 3 or 6: l
 * times such a torque needs at most l parts[0] + l^2 parts[1]. parts[2]: largest l at which every joint keeps its
 * effort limit; with `clipped`, a joint that would exceed its limit counts with the limit.
 *
 * As in sum_reserve, joint i needs holds_i |torque_i| while its torque is held, and falls_i torque_i^2 while it falls.
 * The sum of holds_i |torque_i| is at most the root of (sum holds_i) (sum holds_i torque_i^2) (Cauchy and Schwarz).
 */
static void bound_wrench(const config_t *c, int rows, const double *J, const double *size, int clipped, double *parts)
{
    double W[6 * N], holds[N], falls[N], sum = 0.0;
    const int gap = limit_call_gap(c, c->missed_limit);
    parts[2] = HUGE_VAL;
    for (int i = 0; i < N; ++i) {
        const double v = c->velocity_limit[i], fall = 0.5 * v * gap / c->torque_rate_limit[i];
        const double hold = v * c->sample_time * (gap * c->missed_limit + c->delay_samples);
        double square = 0.0;
        for (int k = 0; k < rows; ++k) {
            W[k * N + i] = size[k] * J[k * N + i];
            square += W[k * N + i] * W[k * N + i];
        }
        const double largest_torque = sqrt(square); /* of the worst w */
        const double kept = largest_torque > 0.0 ? c->effort_limit[i] / largest_torque : HUGE_VAL;
        const double share = clipped ? smaller(kept, 1.0) : 1.0;
        parts[2] = smaller(parts[2], kept);
        sum += hold;
        holds[i] = hold * share * share;
        falls[i] = fall * share * share;
    }
    parts[0] = sqrt(sum * bound_quadratic(rows, W, holds));
    parts[1] = bound_quadratic(rows, W, falls);
}

/* Return the largest l for which l a + l^2 b is at most `most`. */
double solve_share(double a, double b, double most)
{
    return most > 0.0 ? 2.0 * most / (a + sqrt(a * a + 4.0 * b * most)) : 0.0;
}

/*
 * Compute the tank that covers heaviest_wrench at every tip in all of POSTURES postures, as far as the effort limits of
 * the joints allow it there. A tool that is given at run time is not known yet: the lever arms are those of the tip.
 */
double size_tank(const config_t *c, const memory_t *m)
{
    double size[6], most = 0.0;
    for (int k = 0; k < 6; ++k) {
        size[k] = c->heaviest_wrench[k / 3];
    }
    for (int k = 0; k < POSTURES; ++k) {
        double q[N], J[6 * N * TIPS], sum = 0.0;
        place_posture(c, m, k, q);
        stiffgen_jacobians(q, m, J);
        for (int t = 0; t < TIPS; ++t) {
            double parts[3];
            bound_wrench(c, 6, J + 6 * N * t, size, 1, parts);
            sum += parts[0] + parts[1]; /* l = 1 */
        }
        most = larger(most, sum);
    }
    return most / COVERED;
}

/* Find tank, engagement limit and energy limit in force, from the configuration or from heaviest_wrench. */
void find_energies(step_t *s)
{
    const config_t *const c = s->c;
    const memory_t *const m = s->m;
    const double force = c->heaviest_wrench[0], moment = c->heaviest_wrench[1];
    const double powers[2] = {force * c->tip_velocity_limit, moment * c->tip_rotation_limit};
    s->tank_initial = c->tank_initial > 0.0 ? c->tank_initial : m->sized_tank;
    s->engagement_limit = c->engagement_limit > 0.0 ? c->engagement_limit : GOVERNOR * norm(2, powers) * TRAVEL_TIME;
    s->energy_limit = c->energy_limit;
    if (!(c->energy_limit > 0.0)) {
        const double Kt = largest_entry(9 * TIPS, m->translation_stiffness);
        const double Ko = largest_entry(9 * TIPS, m->rotation_stiffness);
        /* whatever the direction, the springs store this much before they exert the wrench */
        const double by_force = force * force / larger(Kt, NO_STIFFNESS);
        const double least = 0.5 * smaller(by_force, moment * moment / larger(Ko, NO_STIFFNESS));
        /* along the present deflection, as note_load says */
        const double along = m->load > NO_LOAD ? larger(least, m->load_energy / (m->load * m->load)) : least;
        s->energy_limit = smaller(along, LARGEST_ENERGY);
    }
}

/*
 * Note the wrench that the springs exert, relative to heaviest_wrench, with the energy stored at it: along the present
 * deflection the springs exert heaviest_wrench at that energy over the square of the load.
 */
void note_load(step_t *s, double energy)
{
    memory_t *const m = s->m;
    m->load = 0.0;
    for (int t = 0; t < TIPS; ++t) {
        const double *const w = s->out->spring_wrench + 6 * t;
        const double parts[2] = {norm(3, w) / s->c->heaviest_wrench[0], norm(3, w + 3) / s->c->heaviest_wrench[1]};
        m->load = larger(m->load, norm(2, parts));
    }
    m->load_energy = energy;
}

/* Return the Jacobians of the tips at the last known position, with the tool in force; a step computes them once. */
const double *find_jacobians(step_t *s)
{
    if (!s->has_jacobians) {
        stiffgen_jacobians(s->m->q, s->m, s->jacobians);
        s->has_jacobians = 1;
    }
    return s->jacobians;
}

/* Compute the force that effort limits and available energy cover at every tip, whatever its direction. */
void report_force(step_t *s)
{
    const memory_t *const m = s->m;
    const double unit[3] = {1.0, 1.0, 1.0};
    const double *const J = find_jacobians(s);
    double parts[3];
    s->out->force_available = HUGE_VAL;
    for (int t = 0; t < TIPS; ++t) {
        bound_wrench(s->c, 3, J + 6 * N * t, unit, 0, parts);
        const double covered = solve_share(parts[0], parts[1], COVERED * available_energy(m));
        s->out->force_available = smaller(s->out->force_available, smaller(covered, parts[2]));
    }
}
