/* SPDX-License-Identifier: MIT */
#include "arms.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

enum { SUBSTEPS = 10 };

typedef struct {
    double q[N], v[N];           /* links */
    double theta[N], omega[N];   /* motors; rigid: the same */
    double bristle[N];           /* [rad] deflection of the friction */
    double clamp[16];
    int clamped;
} motion_t;

/* What holds for one sample. */
typedef struct {
    double M[N * N]; /* Cholesky factor */
    double bias[N], J[6 * N], pose[16], start[N], load[6];
    double wall, wall_speed; /* [m], [m/s] */
} instant_t;

int factorise(int n, double *A)
{
    for (int i = 0; i < n; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = A[i * n + j];
            for (int k = 0; k < j; ++k) {
                sum -= A[i * n + k] * A[j * n + k];
            }
            if (i == j && !(sum > 0.0)) {
                return -1;
            }
            A[i * n + j] = i == j ? sqrt(sum) : sum / A[j * n + j];
        }
    }
    return 0;
}

void solve(int n, const double *L, double *x)
{
    for (int i = 0; i < n; ++i) {
        for (int k = 0; k < i; ++k) {
            x[i] -= L[i * n + k] * x[k];
        }
        x[i] /= L[i * n + i];
    }
    for (int i = n - 1; i >= 0; --i) {
        for (int k = i + 1; k < n; ++k) {
            x[i] -= L[k * n + i] * x[k];
        }
        x[i] /= L[i * n + i];
    }
}

static int flexible(const plant_t *p)
{
    return p->joint_spring[0] > 0.0;
}

/* Compute dynamics, Jacobian and load of the sample; the payload is a mass at the tip. */
static void start_instant(const plant_t *p, const motion_t *m, const double *load, double payload, instant_t *at)
{
    const double none[3] = {0.0, 0.0, 0.0};
    memcpy(at->start, m->q, sizeof at->start);
    memcpy(at->load, load, sizeof at->load);
    at->load[2] -= 9.81 * payload;
    ROBOT_(mass_matrix)(m->q, at->M);
    ROBOT_(bias_forces)(m->q, m->v, none, at->bias);
    ROBOT_(hybrid_jacobian)(m->q, at->J);
    ROBOT_(forward_kinematics)(m->q, at->pose);
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j < N; ++j) {
            for (int k = 0; k < 3; ++k) {
                at->M[i * N + j] += payload * at->J[k * N + i] * at->J[k * N + j];
            }
        }
        at->M[i * (N + 1)] += flexible(p) ? 1e-3 : p->motor[i];
    }
    factorise(N, at->M);
}

/* Compute the wrench of wall and clamp on the tip, a time after the sample. */
static void touch(const plant_t *p, const motion_t *m, const instant_t *at, double time, double *wrench)
{
    double moved[6] = {0.0}, twist[6] = {0.0}, place[3];
    memset(wrench, 0, 6 * sizeof *wrench);
    for (int k = 0; k < 6; ++k) {
        for (int i = 0; i < N; ++i) {
            moved[k] += at->J[k * N + i] * (m->q[i] - at->start[i]);
            twist[k] += at->J[k * N + i] * m->v[i];
        }
    }
    for (int k = 0; k < 3; ++k) {
        place[k] = at->pose[4 * k + 3] + moved[k];
    }
    touch_surface(p, place, twist, at->wall + at->wall_speed * time, at->wall_speed, wrench);
    if (m->clamped) {
        const double *const C = m->clamp, *const H = at->pose;
        double turn[9] = {0.0};
        for (int k = 0; k < 27; ++k) {
            turn[k / 3] += H[k / 9 * 4 + k % 3] * C[k / 3 % 3 * 4 + k % 3];
        }
        const double error[6] = {H[3] - C[3], H[7] - C[7], H[11] - C[11], (turn[7] - turn[5]) / 2.0,
                                 (turn[2] - turn[6]) / 2.0, (turn[3] - turn[1]) / 2.0};
        for (int k = 0; k < 6; ++k) {
            wrench[k] -= (k < 3 ? 5e4 : 1e3) * (error[k] + moved[k] + 2e-3 * twist[k]);
        }
    }
}

/* Friction of joint i: a bristle that breaks loose (LuGre); more at rest than in motion. */
static double rub(const plant_t *p, motion_t *m, int i, double speed, double h)
{
    if (p->coulomb[i] <= 0.0) {
        return p->viscous[i] * speed;
    }
    const double fast = speed / 0.01, most = p->coulomb[i] * (1.0 + 0.5 * exp(-fast * fast)), stiffness = most / 2e-4;
    m->bristle[i] = (m->bristle[i] + h * speed) / (1.0 + h * fabs(speed) * stiffness / most);
    return stiffness * m->bristle[i] + 0.02 * p->coulomb[i] * speed + p->viscous[i] * speed;
}

static double stop(const plant_t *p, const motion_t *m, int i)
{
    const double above = m->q[i] - ROBOT_(upper)[i] - 0.05, below = m->q[i] - ROBOT_(lower)[i] + 0.05;
    const double depth = above > 0.0 ? above : fmin(below, 0.0);
    return p->stop_stiffness > 0.0 ? -p->stop_stiffness * depth : 0.0;
}

/* Advance the arm by a sample time under a torque. Return the torque's work. */
static double advance(const plant_t *p, motion_t *m, const instant_t *at, const double *torque, double *contact)
{
    const double h = p->sample_time / SUBSTEPS;
    double work = 0.0, wrench[6];
    memset(contact, 0, 6 * sizeof *contact);
    for (int s = 0; s < SUBSTEPS; ++s) {
        double force[N];
        touch(p, m, at, s * h, wrench);
        for (int k = 0; k < 6; ++k) {
            contact[k] += wrench[k] / SUBSTEPS;
        }
        for (int i = 0; i < N; ++i) {
            const double friction = rub(p, m, i, m->omega[i], h);
            force[i] = stop(p, m, i) - at->bias[i];
            for (int k = 0; k < 6; ++k) {
                force[i] += at->J[k * N + i] * (at->load[k] + wrench[k]);
            }
            if (flexible(p)) {
                const double spring = p->joint_spring[i] * (m->theta[i] - m->q[i] + 2e-4 * (m->omega[i] - m->v[i]));
                force[i] += spring;
                m->omega[i] += h * (torque[i] - friction - spring) / p->motor[i];
            } else {
                force[i] += torque[i] - friction;
            }
        }
        solve(N, at->M, force);
        for (int i = 0; i < N; ++i) {
            m->v[i] += h * force[i];
            m->q[i] += h * m->v[i];
            m->omega[i] = flexible(p) ? m->omega[i] : m->v[i];
            m->theta[i] = flexible(p) ? m->theta[i] + h * m->omega[i] : m->q[i];
            work += h * torque[i] * m->omega[i];
        }
    }
    return work;
}

typedef struct {
    double q[N], dq[N], held_q[N], held_dq[N], seen_q[N];
    uint32_t counter;
    int age, seen;
} sensors_t;

static double rounded(double x, double quantum)
{
    return quantum > 0.0 ? quantum * nearbyint(x / quantum) : x;
}

/* Measure the motors; a state is new every state_period samples. */
static void measure(const plant_t *p, const motion_t *m, const double *noise, const double *offset, int fault,
                    sensors_t *s)
{
    const int renew = s->seen == 0 || ++s->age >= p->state_period;
    for (int i = 0; renew && i < N; ++i) {
        const double q = p->unit[i] * rounded(m->theta[i], p->position_quantum) + offset[i];
        const double change = s->seen ? (q - s->seen_q[i]) / (p->sample_time * s->age) : 0.0;
        s->dq[i] = p->differences ? change : p->unit[i] * rounded(m->omega[i] + noise[i], p->velocity_quantum);
        s->seen_q[i] = s->q[i] = q;
    }
    s->age = renew ? 0 : s->age;
    s->seen = 1;
    s->counter += fault != COUNTER_FROZEN;
    for (int i = 0; i < N; ++i) {
        const int q_frozen = fault == Q_FROZEN || fault == BOTH_FROZEN;
        const int dq_frozen = fault == DQ_FROZEN || fault == BOTH_FROZEN;
        s->q[i] = fault == NOT_A_NUMBER ? (double)NAN : q_frozen ? s->held_q[i] : s->q[i];
        s->dq[i] = fault == DQ_ZERO ? 0.0 : fault == DQ_REVERSED ? -3.0 * s->dq[i] : dq_frozen ? s->held_dq[i] : s->dq[i];
        s->held_q[i] = q_frozen ? s->held_q[i] : s->q[i];
        s->held_dq[i] = dq_frozen ? s->held_dq[i] : s->dq[i];
    }
}

typedef struct {
    const ROBOT_(impedance_config) *config;
    ROBOT_(impedance_state) *state;
    ROBOT_(impedance_output) *output;
    makers_t makers;
    int stepped;
} controller_t;

/* Step this controller with what the sensors say. */
static void step_controller(const plant_t *p, controller_t *c, const sensors_t *s, const inputs_t *in, int k,
                            const double *wrench, double *torque, row_t *row)
{
    ROBOT_(impedance_input) input;
    memset(&input, 0, sizeof input);
    input.sample_valid = in->sensor[k] != LOST;
    input.clock = JOIN(UPPER, _CLOCK_COUNTER);
    input.counter = s->counter;
    input.shaped = p->shaped;
    memcpy(input.q, s->q, sizeof input.q);
    memcpy(input.dq, s->dq, sizeof input.dq);
    memcpy(input.q0, in->goal + k * N, sizeof input.q0);
    if (p->makers) {
        made_t made;
        make_command(p, &c->makers, in, k, wrench, c->stepped ? c->output : NULL, &made, row);
        memcpy(input.q0, made.q0, sizeof input.q0);
        memcpy(input.wrench_command, made.wrench_command, sizeof input.wrench_command);
    }
    for (int i = 0; i < N; ++i) {
        input.posture_stiffness[i] = 1.0;
    }
    for (int i = 0; i < 3; ++i) {
        input.translation_stiffness[4 * i] = in->translation[3 * k + i];
        input.rotation_stiffness[4 * i] = in->rotation[3 * k + i];
    }
    ROBOT_(impedance_step)(c->state, &input, c->output);
    c->stepped = 1;
    row->supplied = c->output->energy_supplied;
    row->tank = c->output->tank;
    memcpy(torque, c->output->torque, N * sizeof *torque);
    row->status = c->output->status;
    row->reason = c->output->reason;
    row->faulted = c->output->fault != 0;
    const unsigned cut = JOIN(UPPER, _STATUS_SATURATED) | JOIN(UPPER, _STATUS_RATE_LIMITED);
    row->saturated = (c->output->status & cut) != 0u;
    if (p->reset_after > 0 && c->output->fault_time > p->reset_after * p->sample_time && row->faulted) {
        ROBOT_(impedance_reset)(c->state);
    }
}

/* Step a textbook law, and limit its torque and the torque's rate. */
static void step_textbook(const plant_t *p, const sensors_t *s, const inputs_t *in, int k, memory_t *memory,
                          double *torque, row_t *row)
{
    sample_t sample;
    double wanted[N];
    memcpy(sample.q, s->q, sizeof sample.q);
    memcpy(sample.dq, s->dq, sizeof sample.dq);
    memcpy(sample.goal, in->goal + k * N, sizeof sample.goal);
    memcpy(sample.pose, in->pose + 16 * k, sizeof sample.pose);
    memcpy(sample.translation, in->translation + 3 * k, sizeof sample.translation);
    memcpy(sample.rotation, in->rotation + 3 * k, sizeof sample.rotation);
    sample.sample_time = p->sample_time;
    textbook(p->law, &sample, memory, wanted);
    for (int i = 0; i < N; ++i) {
        const double change = p->rate[i] * p->sample_time;
        const double near = fmin(fmax(wanted[i], -p->effort[i]), p->effort[i]);
        torque[i] = fmin(fmax(near, torque[i] - change), torque[i] + change);
        row->saturated |= torque[i] != wanted[i];
    }
}

int run(const plant_t *p, const void *config, void *state, void *output, const double *q, int samples,
        const inputs_t *in, row_t *rows)
{
    static const double nothing[6] = {0.0};
    controller_t controller = {.config = config, .state = state, .output = output};
    motion_t motion;
    sensors_t sensors;
    memory_t memory;
    double torque[N] = {0.0}, pipe[MOST_DELAY + 1][N] = {{0.0}}, work = 0.0;
    memset(&motion, 0, sizeof motion);
    memset(&sensors, 0, sizeof sensors);
    memset(&memory, 0, sizeof memory);
    memcpy(motion.q, q, sizeof motion.q);
    memcpy(motion.theta, q, sizeof motion.theta);
    int code = ROBOT_(impedance_init)(controller.config, controller.state, NULL);
    code = code == 0 && p->makers ? start_makers(p, controller.config, q, &controller.makers) : code;
    for (int k = 0; code == 0 && k < samples; ++k) {
        instant_t at;
        row_t *const row = rows + k;
        memset(row, 0, sizeof *row);
        start_instant(p, &motion, in->load + 6 * k, in->payload[k], &at);
        at.wall = in->wall[k];
        at.wall_speed = k + 1 < samples ? (in->wall[k + 1] - in->wall[k]) / p->sample_time : 0.0;
        if (k == p->clamp_start) {
            memcpy(motion.clamp, at.pose, sizeof motion.clamp);
            motion.clamped = 1;
        }
        measure(p, &motion, in->noise + k * N, in->offset + k * N, in->sensor[k], &sensors);
        if (in->sensor[k] == SKIPPED) {
            *row = k > 0 ? rows[k - 1] : *row;
        } else if (p->law == 0) {
            const int fresh = k - 1 - (int)p->wrench_delay, last = (int)p->wrench_last;
            const int seen = last > 0 && last < fresh ? last : fresh;
            step_controller(p, &controller, &sensors, in, k, seen >= 0 ? rows[seen].contact : nothing, torque, row);
        } else if (in->sensor[k] != LOST) {
            step_textbook(p, &sensors, in, k, &memory, torque, row);
        }
        memmove(pipe + 1, pipe, sizeof pipe - sizeof pipe[0]);
        memcpy(pipe[0], torque, sizeof pipe[0]);
        work += advance(p, &motion, &at, pipe[p->delay], row->contact);
        memcpy(row->q, motion.q, sizeof row->q);
        memcpy(row->v, motion.v, sizeof row->v);
        memcpy(row->motors, motion.theta, sizeof row->motors);
        memcpy(row->torque, pipe[p->delay], sizeof row->torque);
        memcpy(row->pose, at.pose, sizeof row->pose);
        row->work = work;
    }
    return code;
}

/* The defaults, and what has none but the motors: 1 ms, the usual wrench. */
void defaults(void *config)
{
    ROBOT_(impedance_config) *const c = config;
    ROBOT_(impedance_default_config)(c);
    c->sample_time = 1e-3;
    c->delay_samples = 1;
    c->heaviest_wrench[0] = 100.0;
    c->heaviest_wrench[1] = 20.0;
}
