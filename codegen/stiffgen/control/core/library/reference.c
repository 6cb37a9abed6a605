/* The reference moves to q0 within its limits of speed, ramp, wrench and work; the stiffness follows the command. */
#include "impedance.h"

static const double STIFFNESS_TIME = 0.02;  /* [s] time constant of a change of stiffness */
static const double SAME_STIFFNESS = 1e-3;  /* [N/m], [N m/rad] that a change of stiffness ends with */
static const double ARRIVED = 1e-12;        /* [s] of travel that is none */
enum { TRIALS = 6, HALVINGS = 3 };          /* shares of a move that are tried: within speed, then three halves */

/* Return the largest entry over the reference's share of its speed limit. */
double relative_speed(const config_t *c, const double *x)
{
    double most = 0.0;
    for (int i = 0; i < N; ++i) {
        most = larger(most, fabs(x[i]) / (SPEED * c->velocity_limit[i]));
    }
    return most;
}

/*
 * Find the reference's next velocity: the command's own motion if that is within the limits, and a speed towards q0
 * from which a ramp can stop, changed no faster than the ramp. Below half of its speed the reference settles
 * exponentially: an abrupt end of the braking throws the arm beyond q0 (8 mm for 2). Return whether it moves.
 */
static int approach(const memory_t *m, const command_t *k, double *dr)
{
    const config_t *const c = &m->config;
    const reference_t *const f = &m->reference;
    const double T = c->sample_time, slope = (k->shaped ? SHAPED : 1.0) * T / c->ramp_time;
    double moved[N], rest[N], change[N];
    for (int i = 0; i < N; ++i) {
        moved[i] = k->accepted ? k->q0[i] - nearest_turn(i, f->wanted[i], k->q0[i]) : 0.0;
    }
    const int follow = relative_speed(c, moved) <= T;
    for (int i = 0; i < N; ++i) {
        moved[i] = follow ? moved[i] : 0.0;
        rest[i] = k->accepted ? k->q0[i] - f->r[i] - moved[i] : 0.0;
    }
    const double way = relative_speed(c, rest); /* [s] */
    const double speed = smaller(stopping_speed(way, slope, T), 1.0);
    for (int i = 0; i < N; ++i) {
        dr[i] = moved[i] / T + (way > 0.0 ? rest[i] * (speed / way) : 0.0);
    }
    const double size = larger(relative_speed(c, dr), 1.0);
    for (int i = 0; i < N; ++i) {
        change[i] = dr[i] / size - f->dr[i];
    }
    const double jump = larger(relative_speed(c, change) / slope, 1.0);
    for (int i = 0; i < N; ++i) {
        dr[i] = f->dr[i] + change[i] / jump;
    }
    return way > ARRIVED || relative_speed(c, dr) > 0.0;
}

/* Return how fast a move of the poses in a sample time is, over the governor's share of the tips' velocity limits. */
static double tip_speed(const memory_t *m, const double *poses)
{
    const double *const limit = m->config.tip_velocity_limit;
    double most = 0.0;
    for (int t = 0; t < TIPS; ++t) {
        double moved = 0.0, turned = 0.0; /* squares of the distance, and of 2 sqrt(2) sin(angle / 2) */
        for (int k = 16 * t; k < 16 * t + 12; ++k) {
            const double change = poses[k] - m->reference.equilibrium[k], square = change * change;
            moved += k % 4 == 3 ? square : 0.0;
            turned += k % 4 == 3 ? 0.0 : square;
        }
        const double angle = 2.0 * asin(smaller(sqrt(0.125 * turned), 1.0));
        const double speed = larger(angle / limit[1], sqrt(moved) / limit[0]);
        most = speed <= most ? most : speed; /* NaN stays */
    }
    return most / (GOVERNOR * m->config.sample_time);
}

/* Return the largest wrench of a tip's spring, with its equilibria at poses, over heaviest_wrench. */
static double find_load(const memory_t *m, const double *poses)
{
    double wrench[6 * TIPS], most = 0.0;
    stiffgen_spring_wrench(m->watch.q, m, poses, m->stiffness.translation, m->stiffness.rotation, wrench);
    for (int t = 0; t < TIPS; ++t) {
        const double parts[2] = {norm(3, wrench + 6 * t) / m->config.heaviest_wrench[0],
                                 norm(3, wrench + 6 * t + 3) / m->config.heaviest_wrench[1]};
        most = larger(most, norm(2, parts));
    }
    return m->reference.scale * most;
}

/* Return whether a move that raises the energy is allowed: the tank pays, no spring exceeds heaviest_wrench more. */
static int may_rise(const memory_t *m, const move_t *g)
{
    if (!(g->rise > 0.0)) {
        return g->rise <= 0.0; /* NaN is not */
    }
    if (g->rise > budget(m)) {
        return 0;
    }
    const double load = find_load(m, g->equilibrium);
    return load <= 1.0 || load <= find_load(m, m->reference.equilibrium);
}

/* Place the reference at a share of its velocity for a sample time. Return the tips' speed there over their limits. */
static double place(const memory_t *m, double share, move_t *g)
{
    const reference_t *const f = &m->reference;
    for (int i = 0; i < N; ++i) {
        g->r[i] = f->r[i] + share * m->config.sample_time * g->dr[i];
    }
    stiffgen_poses(g->r, m, g->equilibrium);
    g->rise = f->scale * spring_energy(m, m->watch.q, g->r, g->equilibrium, &m->stiffness) - m->account.springs;
    return tip_speed(m, g->equilibrium);
}

/* Stand still. */
static void stand(const memory_t *m, move_t *g)
{
    memcpy(g->r, m->reference.r, sizeof g->r);
    memset(g->dr, 0, sizeof g->dr);
    memcpy(g->equilibrium, m->reference.equilibrium, sizeof g->equilibrium);
    g->rise = g->travel = 0.0;
}

/* Move the reference by a share of its velocity: within tip speed, heaviest_wrench, and the tank's work. */
void govern(const memory_t *m, const command_t *k, move_t *g)
{
    const double T = m->config.sample_time;
    double share = 1.0;
    g->status = 0u;
    if (!approach(m, k, g->dr)) {
        stand(m, g);
        return;
    }
    g->status = (uint32_t)ID(STATUS_MOVING);
    for (int trial = 0; trial < TRIALS && share > 0.0; ++trial) {
        const double speed = place(m, share, g);
        if (speed <= 1.0 && may_rise(m, g)) {
            for (int i = 0; i < N; ++i) {
                g->dr[i] *= share;
            }
            g->travel = larger(speed * T, T * relative_speed(&m->config, g->dr));
            return;
        }
        g->status |= speed > 1.0 ? 0u : (uint32_t)ID(STATUS_GOVERNOR);
        const double less = trial < HALVINGS ? 0.5 : 0.0;
        share *= speed > 1.0 ? (1.0 - ROUNDED) / speed : less;
    }
    stand(m, g);
}

/* Mix the stiffness in force with the commanded one, which is taken as it is once it is near. Find the energy. */
static void mix_stiffness(const memory_t *m, const stiffness_t *wanted, double share, change_t *next)
{
    const reference_t *const f = &m->reference;
    const stiffness_t *const K = &m->stiffness;
    const double a = mix(9 * SPRINGS, K->translation, wanted->translation, share, next->stiffness.translation);
    const double b = mix(9 * SPRINGS, K->rotation, wanted->rotation, share, next->stiffness.rotation);
    const double c = mix(N, K->posture, wanted->posture, share, next->stiffness.posture);
    if (larger(a, larger(b, c)) < SAME_STIFFNESS) {
        next->stiffness = *wanted;
    }
    next->energy = f->scale * spring_energy(m, m->watch.q, f->r, f->equilibrium, &next->stiffness);
}

/* Change the stiffness towards the commanded one, as far as the tank can pay: the energy is linear in the share. */
void stiffen(const memory_t *m, const command_t *k, change_t *next)
{
    const int same = memcmp(&m->stiffness, &k->stiffness, sizeof m->stiffness) == 0;
    double share = smaller(1.0, m->config.sample_time / STIFFNESS_TIME);
    next->status = 0u;
    for (int trial = 0; k->accepted && !same && trial < 2; ++trial) {
        mix_stiffness(m, &k->stiffness, share, next);
        const double cost = next->energy - m->account.springs, most = budget(m);
        if (cost <= most) {
            return;
        }
        next->status = (uint32_t)ID(STATUS_TANK_LIMITED);
        share *= (1.0 - ROUNDED) * most / cost;
    }
    next->stiffness = m->stiffness;
    next->energy = m->account.springs;
}
