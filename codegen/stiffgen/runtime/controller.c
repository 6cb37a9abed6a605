/*
 * The step of a controller. docs/controller.md has the equations, the theorem and the names used here:
 *   U(q; r, K)   energy of the springs at the tips' poses, with the equilibrium r and the stiffness K
 *   l            scale; what acts is the gradient of l U
 *   s, p, v      energy put in by sampling, by moving the equilibrium, by changing stiffness or scale
 *
 * Order of a step: is the sample believed? -> account of the interval that ended (s) -> faults -> governor (p) ->
 * stiffness (v) -> tangent, damping -> scale (v) -> torque that is covered, within its limits.
 */
typedef struct {
    const config_t *c;
    memory_t *m;
    double *scratch;
    const input_t *input;
    output_t *out;
    uint32_t status;
    int believed;  /* the sample is */
    int located;   /* its position is, which is enough in a fault */
    int jumped;    /* and not where the position known last can have led */
    int commanded; /* the command is accepted */
    double budget; /* of the tank, for what costs */
    double old_equilibrium[16 * TIPS];
    double velocity[N];
    double limit_slope[N]; /* of the limit avoidance, where it acts */
    double brake[N];       /* [N m s/rad] that may still be added to the damping of one joint */
} frame;

enum { READY = 0x51f7, RECENT = 8 };

/* Bounds on B and on the stiffness, against M, at the sample time: a double integrator with differenced velocity is
 * unstable from M^-1 B T = 2.0, 0.83, 0.53 on at a delay of 0, 1, 2 samples. */
static const double LARGEST_DAMPING = 0.25, LARGEST_STIFFNESS = 0.0625;
static const double FARTHEST = 1e6; /* beyond it an angle has lost its last digits */
static const double GOVERNOR = 0.8; /* of its velocity limits: the rest is for the arm, which overshoots a ramp */
static const double BRAKED = 0.9;   /* of them: faster joints are braked */
/* Paper's law [rad]: up to here a sine is within 10 % of its angle, which is what the law takes it for. */
static const double PAPER_DEFLECTION = 0.7853981633974483;
static const double TANK_FLOOR = 0.1;  /* of the tank's maximum, that stiffness is not paid from */
static const double COVERED = 0.7;    /* of what covers the torques, that the springs may use: the rest is for damping */

static double clamp(double x, double least, double most)
{
    return x < least ? least : x > most ? most : x;
}

static double dot(int count, const double *a, const double *b)
{
    double sum = 0.0;
    for (int i = 0; i < count; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

static double norm(int count, const double *x)
{
    return sqrt(dot(count, x, x));
}

/* y += a x. */
static void add(int count, double a, const double *x, double *y)
{
    for (int i = 0; i < count; ++i) {
        y[i] += a * x[i];
    }
}

static void multiply(const double *A, const double *x, double *result)
{
    for (int i = 0; i < N; ++i) {
        result[i] = dot(N, A + i * N, x);
    }
}

/* C = A B of 3 x 3 matrices with the given row lengths; A transposed if asked for. */
static void multiply3(const double *A, int a, int transposed, const double *B, int b, double *C)
{
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            double sum = 0.0;
            for (int k = 0; k < 3; ++k) {
                sum += (transposed ? A[a * k + i] : A[a * i + k]) * B[b * k + j];
            }
            C[3 * i + j] = sum;
        }
    }
}

/* ---- configuration ---- */

static int validate(const config_t *c)
{
    for (size_t r = 0; r < sizeof RULES / sizeof *RULES; ++r) {
        const char *const at = (const char *)c + RULES[r].offset;
        for (size_t i = 0; i < RULES[r].count; ++i) {
            const double x = RULES[r].integer ? (double)((const int *)(const void *)at)[i]
                                              : ((const double *)(const void *)at)[i];
            if (!(x >= RULES[r].least && x <= RULES[r].most)) {
                return RULES[r].code;
            }
        }
    }
    for (int i = 0; i < N; ++i) {
        if (!(c->upper_limit[i] - c->lower_limit[i] > 2.0 * c->limit_zone)) {
            return ID(E_POSITION_LIMITS);
        }
    }
    if (c->damping_design == ID(DAMPING_DESIGN_TASK) && !is_positive_semidefinite(6, c->task_damping)) {
        return ID(E_TASK_DAMPING_SIGN);
    }
    if (c->law == ID(LAW_PAPER) && TIPS > 1) {
        return ID(E_PAPER_TIPS);
    }
    return c->tank_initial <= c->tank_maximum ? ID(OK) : ID(E_TANK);
}

/* ---- state: checksum and the torque kept three times ---- */

static uint64_t checksum(const state_t *state)
{
    uint64_t sums[4] = {0x9e3779b97f4a7c15u, 0xc2b2ae3d27d4eb4fu, 0x165667b19e3779f9u, 0x27d4eb2f165667c5u}, word;
    for (size_t k = 0; k < sizeof state->memory / sizeof word; ++k) {
        memcpy(&word, (const char *)&state->memory + k * sizeof word, sizeof word);
        sums[k % 4] = (sums[k % 4] ^ word) * 0x100000001b3u;
    }
    return sums[0] + 3u * sums[1] + 5u * sums[2] + 7u * sums[3]; /* any one word changed changes it */
}

/* What two of three copies say, bit by bit. */
static void majority(const double *copies, double *result)
{
    for (int i = 0; i < N; ++i) {
        uint64_t a, b, c;
        memcpy(&a, copies + i, sizeof a);
        memcpy(&b, copies + N + i, sizeof b);
        memcpy(&c, copies + 2 * N + i, sizeof c);
        a = (a & b) | (b & c) | (a & c);
        memcpy(result + i, &a, sizeof a);
        result[i] = fabs(result[i]) <= DBL_MAX ? result[i] : 0.0;
    }
}

static void keep(double *copies, const double *values)
{
    for (int copy = 0; copy < 3; ++copy) {
        memcpy(copies + copy * N, values, N * sizeof(double));
    }
}

/* One step towards zero. */
static void fall(const double *last, const double *rate, double *torque)
{
    for (int i = 0; i < N; ++i) {
        torque[i] = last[i] - clamp(last[i], -rate[i], rate[i]);
    }
}

static void begin(const config_t *c, state_t *state)
{
    memory_t *const m = &state->memory;
    memset(m, 0, sizeof *m);
    for (int i = 0; i < N; ++i) {
        m->rate[i] = c->torque_rate_limit[i] * c->sample_time;
    }
    keep(state->rate, m->rate);
    memcpy(m->velocity_limit, c->velocity_limit, sizeof m->velocity_limit);
    m->tank = c->tank_initial;
    m->ready = READY;
}

static int initialise(const config_t *c, state_t *state, const double *torque)
{
    if (c == NULL || state == NULL) {
        return ID(E_NULL);
    }
    memset(state, 0, sizeof *state);
    const int error = validate(c);
    if (error != ID(OK)) {
        return error;
    }
    for (int i = 0; torque != NULL && i < N; ++i) {
        if (!(fabs(torque[i]) <= c->effort_limit[i])) {
            return ID(E_TORQUE);
        }
    }
    begin(c, state);
    if (torque != NULL) {
        keep(state->torque, torque);
    }
    state->checksum = checksum(state);
    return ID(OK);
}

static int reset(state_t *state)
{
    if (state == NULL) {
        return ID(E_NULL);
    }
    if (state->checksum != checksum(state) || state->memory.ready != READY) {
        return ID(E_NOT_INITIALISED);
    }
    state->memory.reset = 1;
    state->checksum = checksum(state);
    return ID(OK);
}

/* Latch a fault; the first one stays. */
static void latch(memory_t *m, int reason)
{
    if (m->fault == ID(FAULT_NONE)) {
        m->fault = CLASS[reason];
        m->reason = reason;
        m->fault_time = 0.0;
        m->reset = 0;
    }
    m->good_time = 0.0;
}

/* ---- springs at poses ---- */

/* U at q of the springs of all tips and of the posture, unscaled; the paper's law has none. */
static double energy_at(const memory_t *m, const double *q, const double *equilibrium, const double *posture)
{
    return m->law == ID(LAW_PAPER)
               ? 0.0
               : robot_spring_energy(q, m->tool_pose, equilibrium, m->translation_stiffness, m->rotation_stiffness) +
                     robot_posture_energy(q, posture, m->posture_stiffness);
}

/* What is stored at q. */
static double stored(const memory_t *m, const double *q)
{
    return m->scale * energy_at(m, q, m->equilibrium, m->posture);
}

/*
 * A joint's limit avoidance a = (lower edge, upper edge, k, largest torque): energy k d^2 / 2 at depth d beyond an edge,
 * straight from where the torque is the largest. pull: the energy's slope; stiffness: the slope's.
 */
static double avoidance(const double *a, double q, double *pull, double *stiffness)
{
    const double depth = q > a[1] ? q - a[1] : q < a[0] ? q - a[0] : 0.0, k = a[2];
    *pull = clamp(k * depth, -a[3], a[3]);
    *stiffness = depth != 0.0 && *pull == k * depth ? k : 0.0;
    return *pull == k * depth ? 0.5 * k * depth * depth : fabs(*pull) * (fabs(depth) - 0.5 * fabs(*pull) / k);
}

/* Energy of the limit avoidance of all joints. */
static double avoid_limits(frame *f, const double *q)
{
    double energy = 0.0;
    for (int i = 0; i < N; ++i) {
        const double *const a = f->m->avoidance + 4 * i;
        double pull;
        energy += avoidance(a, q[i], &pull, &f->limit_slope[i]);
        f->out->limit_torque[i] = 0.0 - pull;
        f->status |= q[i] > a[1] || q[i] < a[0] ? (uint32_t)ID(STATUS_JOINT_LIMIT) : 0u;
    }
    return energy;
}

/* ---- account ---- */

/* Into the tank; what a full one cannot hold goes to the engagement: their sum is what bounds the work put out. */
static void tank_income(frame *f, double income)
{
    memory_t *const m = f->m;
    const double most = fmax(f->c->tank_maximum, m->reserve);
    const double lost = m->tank + income - most;
    m->tank += income;
    if (lost > 0.0) {
        m->tank = most;
        m->engagement = fmin(m->engagement + lost, f->c->engagement_limit);
    }
}

static void book_stiffness(frame *f, double *energy, double v)
{
    f->m->stiffness_total += v;
    *energy += v;
    f->budget -= v;
    tank_income(f, -v);
}

/* What moving the equilibrium costs is the engagement's; what it gives back, the tank's. */
static void book_reference(frame *f, double p)
{
    f->m->reference_total += p;
    f->m->engagement -= fmax(p, 0.0);
    tank_income(f, fmax(-p, 0.0));
}

/* The torque that acted in the interval that ends now. */
static const double *acting(const memory_t *m, const double *last)
{
    return m->delay == 0 ? last : m->older + (m->delay - 1) * N;
}

/* Another interval begins: last is on its way, and the share of the reference in the torque that follows it. */
static void pass(memory_t *m, const double *last, const double *feed)
{
    memmove(m->older + N, m->older, N * sizeof(double));
    memcpy(m->older, last, N * sizeof(double));
    memmove(m->feed + N, m->feed, 2 * N * sizeof(double));
    memmove(m->feed, feed, N * sizeof(double));
}

/* Farthest that a joint is taken to move in a sample time. */
static double farthest(const memory_t *m, int i)
{
    return fmax(m->velocity_limit[i], fabs(m->dq[i])) * m->sample_time;
}

/*
 * What the torques on their way can put out, whatever the environment does, until the last of them has gone to zero at the
 * rate limit: no joint faster than its limit, and only one of missed_limit calls made. The torque is held for missed_limit
 * such calls without a sample, and, in a fault, for one. With l times the torque: parts[0] + l parts[1] + l^2 parts[2].
 */
static double reserve(const frame *f, const double *last, const double *torque, double *parts)
{
    const memory_t *const m = f->m;
    const double calls = f->c->missed_limit, held = m->fault != ID(FAULT_NONE) ? 1.0 : calls;
    parts[0] = parts[1] = parts[2] = 0.0;
    for (int i = 0; i < N; ++i) {
        const double size = fabs(torque[i]), far = farthest(m, i);
        parts[0] += far * ((m->delay > 0 ? fabs(last[i]) : 0.0) + (m->delay > 1 ? fabs(m->older[i]) : 0.0));
        parts[1] += far * calls * held * size;
        parts[2] += far * calls * 0.5 * size * (size / m->rate[i]);
    }
    return parts[0] + parts[1] + parts[2];
}

/* What there is for it. */
static double cover(const memory_t *m)
{
    return m->tank + m->elastic_energy + m->limit_energy;
}

/*
 * Take on the configured limit avoidance of each joint whose change stores no more at q than the tank's budget pays; else
 * the old one stays. A first sample is free.
 */
static void adopt_limits(frame *f, const double *q)
{
    const config_t *const c = f->c;
    memory_t *const m = f->m;
    for (int i = 0; i < N; ++i) {
        double *const a = m->avoidance + 4 * i;
        const double wanted[4] = {c->lower_limit[i] + c->limit_zone, c->upper_limit[i] - c->limit_zone,
                                  c->limit_stiffness[i], c->effort_limit[i]};
        if (memcmp(a, wanted, sizeof wanted) == 0) {
            continue;
        }
        if (m->known) {
            double pull, slope;
            const double v = avoidance(wanted, q[i], &pull, &slope) - avoidance(a, q[i], &pull, &slope);
            if (!(v <= fmax(f->budget, 0.0))) {
                f->status |= ID(STATUS_LIMITS_KEPT);
                continue;
            }
            book_stiffness(f, &m->limit_energy, v);
        }
        memcpy(a, wanted, sizeof wanted);
    }
    avoid_limits(f, q);
}

/*
 * Intervals without a believed position. Two bounds on their work: that of the last one's torque over the whole way and,
 * at every change of torque, the change over the way that can have been gone before it; or every torque over its own way.
 */
static void bridge(memory_t *m, const double *last, int periods)
{
    const double *const torque = acting(m, last);
    if (m->gap == 0) {
        m->gap_work = m->gap_most = 0.0;
        memcpy(m->gap_torque, torque, N * sizeof(double));
    }
    for (int i = 0; i < N; ++i) {
        m->gap_work += fabs(torque[i] - m->gap_torque[i]) * farthest(m, i) * m->gap;
        m->gap_most += fabs(torque[i]) * farthest(m, i) * periods;
    }
    memcpy(m->gap_torque, torque, N * sizeof(double));
    m->gap = m->gap < 1000000 - periods ? m->gap + periods : 1000000;
}

/*
 * Energy that the interval up to the believed position q has put in. The damper lies between the arm and the moving
 * reference: what its share for the reference, feed = B dr, does on the arm's way is the reference's work. The account
 * begins, or begins anew, where the position has no known way to.
 */
static void account(frame *f, const double *last, const double *q)
{
    memory_t *const m = f->m;
    double work = 0.0, feed = 0.0, way[N];
    const double elastic = stored(m, q), limit = avoid_limits(f, q);
    const double rise = elastic - m->elastic_energy + limit - m->limit_energy;
    m->elastic_energy = elastic;
    m->limit_energy = limit;
    if (!m->known || f->jumped) {
        m->start_total += rise;
        m->unaccounted += (uint32_t)m->known;
        m->known = 1;
        return;
    }
    memcpy(way, q, sizeof way);
    add(N, -1.0, m->q, way);
    if (m->gap > 0) {
        bridge(m, last, 1);
        work = fmin(m->gap_work + dot(N, m->gap_torque, way), m->gap_most);
    } else {
        work = dot(N, acting(m, last), way);
        feed = fmax(dot(N, m->feed + m->delay * N, way), 0.0);
    }
    m->port_total += work;
    m->sampling_total += rise + work - feed;
    tank_income(f, feed - work - rise);
    book_reference(f, feed);
}

/* ---- is the sample believed? ---- */

/*
 * Count samples that are missing, and half a one back for each that is there (periods 0): missed_limit in a row are a
 * fault, and so are more than one of three for long.
 */
static void absent(frame *f, int periods, int reason)
{
    memory_t *const m = f->m;
    const int count = m->absent + (periods > 0 ? 2 * periods : -1), limit = 2 * f->c->missed_limit;
    m->absent = count < 0 ? 0 : count < limit ? count : limit;
    if (count >= limit && m->known) {
        latch(m, reason);
    }
}

/* Samples for which a value has stood still; q's prediction goes on from the last change with the velocity dq. */
static double still(int first, double value, double q, double way, double *seen, double *age, double *predicted)
{
    const int changed = first || value != *seen;
    *seen = value;
    *predicted = changed ? q : *predicted + way;
    *age = changed ? 0.0 : *age + 1.0;
    return *age;
}

enum { FROZEN_POSITION = 1, FROZEN_VELOCITY = 2 };

/* Whether q or dq of a joint stands still while the other moves, over a window. */
static int frozen(const config_t *c, memory_t *m, double q, double dq, int i)
{
    const double window = c->frozen_window, T = c->sample_time, way = dq * T * (1 + m->gap);
    const double most = fmax(4.0 * c->position_quantum, 0.02 * m->velocity_limit[i] * window * T);
    const double q_age = still(!m->known, q, q, way, &m->still_q[i], &m->q_age[i], &m->moved_q[i]);
    const double dq_age = still(!m->known, dq, q, way, &m->still_dq[i], &m->dq_age[i], &m->start_q[i]);
    return (q_age >= window && fabs(q - m->moved_q[i]) > most ? FROZEN_POSITION : 0) |
           (dq_age >= window && fabs(q - m->start_q[i]) > most ? FROZEN_VELOCITY : 0);
}

/*
 * REASON_NONE, or why the sample is not believed. A sample whose position alone is credible still serves in a fault: the
 * velocity is then the other signal's, or, where it is open which of the two is wrong, the smaller one if they agree in
 * sign: damping with too small a velocity puts no energy in.
 */
static int doubt(frame *f, const double *last)
{
    const config_t *const c = f->c;
    memory_t *const m = f->m;
    const input_t *const in = f->input;
    int reason = ID(REASON_NONE);
    for (int i = 0; i < N; ++i) {
        if (!(fabs(in->q[i]) <= FARTHEST && fabs(in->dq[i]) <= 1e3 * m->velocity_limit[i])) {
            return ID(REASON_NOT_FINITE);
        }
    }
    if (m->known) {
        const int32_t ahead = (int32_t)(in->counter - m->counter - (uint32_t)m->gap - 1u);
        const int regular = in->counter == m->seen_counter + 1u;
        m->regular = regular ? (m->regular < 3 ? m->regular + 1 : 3) : 0;
        m->seen_counter = in->counter;
        if (ahead < 0 && (m->fault == ID(FAULT_NONE) || m->regular < 3)) {
            return ID(REASON_STALE);
        }
        if (ahead > 0) {
            f->status |= ID(STATUS_MISSED);
            if (m->gap > 0) { /* between which of the calls without a sample is not known */
                m->gap_work = HUGE_VAL;
                m->gap_most *= fmin(1.0 + ahead, c->missed_limit);
            }
            for (int k = 0; k < ahead && k < 3; ++k) { /* the torque of the last call was held */
                bridge(m, last, 1);
                pass(m, last, m->feed);
            }
            bridge(m, last, ahead < 3 ? 0 : ahead < 1000000 ? ahead - 3 : 1000000);
            absent(f, ahead < 1000 ? ahead : 1000, ID(REASON_SKIPPED));
        }
    }
    const double elapsed = c->sample_time * (1 + m->gap);
    /* an arm that is too fast must be braked: in a fault q and dq that agree are believed at any speed */
    const int fault = m->fault != ID(FAULT_NONE);
    f->located = 1;
    for (int i = 0; i < N; ++i) {
        const double way = m->known ? in->q[i] - m->q[i] : in->dq[i] * elapsed;
        const double far = m->velocity_limit[i] * elapsed, measured = way / elapsed;
        const int stuck = frozen(c, m, in->q[i], in->dq[i], i);
        const int differ =
            fabs(in->dq[i] * elapsed - way) > fmax(0.5 * far, 0.3 * fabs(way)) + 2.0 * c->position_quantum;
        f->velocity[i] = in->dq[i];
        if (differ && fabs(way) > 2.0 * far + 2.0 * c->position_quantum) {
            f->velocity[i] = 0.0;
            f->jumped = 1;
            reason = ID(REASON_JUMP);
        } else if (stuck != 0) {
            f->velocity[i] = stuck == FROZEN_VELOCITY ? measured : in->dq[i];
            reason = ID(REASON_FROZEN);
        } else if (differ) {
            f->velocity[i] = measured * in->dq[i] <= 0.0 ? 0.0 : fabs(measured) < fabs(in->dq[i]) ? measured : in->dq[i];
            reason = ID(REASON_MISMATCH);
        }
        if ((differ || !fault) && fabs(way) > (fault ? 10.0 : 2.0) * far + 2.0 * c->position_quantum) {
            f->located = 0;
        }
    }
    if (!f->located) {
        return ID(REASON_JUMP);
    }
    if (reason == ID(REASON_NONE) && c->law == ID(LAW_PAPER) && (f->status & (uint32_t)ID(STATUS_WRENCH_REFUSED)) != 0u) {
        reason = ID(REASON_WRENCH);
    }
    return reason;
}

static void observe_wrench(frame *f)
{
    int good = f->input->wrench_valid == 1;
    for (int t = 0; good && t < TIPS; ++t) {
        const double *const wrench = f->input->wrench + 6 * t;
        good = norm(3, wrench) <= f->c->force_limit && norm(3, wrench + 3) <= f->c->moment_limit;
    }
    if (good) {
        memcpy(f->out->wrench, f->input->wrench, sizeof f->out->wrench);
    } else if (f->input->wrench_valid == 1 || f->c->law == ID(LAW_PAPER)) {
        f->status |= ID(STATUS_WRENCH_REFUSED);
    }
}

/* Is there a sample, and is it believed? Two bad ones of three are a fault. */
static void observe(frame *f, const double *last)
{
    memory_t *const m = f->m;
    int reason = ID(REASON_MISSED);
    if (f->input->sample_valid == 1) {
        observe_wrench(f);
        reason = doubt(f, last);
        m->bad = ((m->bad << 1) | (reason != ID(REASON_NONE))) & 7;
        if (reason != ID(REASON_NONE) && (m->bad & (m->bad - 1)) != 0) {
            latch(m, reason);
        }
    }
    f->believed = reason == ID(REASON_NONE);
    f->status |= f->believed ? 0u : reason == ID(REASON_MISSED) ? (uint32_t)ID(STATUS_MISSED) : (uint32_t)ID(STATUS_BAD_SAMPLE);
    absent(f, !f->believed, reason);
}

static int is_stiffness(const double *K, double most)
{
    return largest(9, K) <= most && is_positive_semidefinite(3, K);
}

static int is_pose(const double *pose)
{
    double C[9], off = fabs(pose[12]) + fabs(pose[13]) + fabs(pose[14]) + fabs(pose[15] - 1.0);
    multiply3(pose, 4, 1, pose, 4, C);
    for (int i = 0; i < 9; ++i) {
        off += fabs(C[i] - (i % 4 == 0 ? 1.0 : 0.0));
    }
    const double det = pose[0] * (pose[5] * pose[10] - pose[6] * pose[9]) - pose[1] * (pose[4] * pose[10] - pose[6] * pose[8]) +
                       pose[2] * (pose[4] * pose[9] - pose[5] * pose[8]);
    return off <= 1e-6 && det > 0.0 && fabs(pose[3]) + fabs(pose[7]) + fabs(pose[11]) <= FARTHEST;
}

static int is_command(const frame *f)
{
    const input_t *const in = f->input;
    int good = in->command == ID(COMMAND_POSITION) || in->command == ID(COMMAND_EQUILIBRIUM);
    for (int i = 0; i < N; ++i) {
        good = good && fabs(in->q0[i]) <= FARTHEST;
    }
    for (int t = 0; good && t < TIPS; ++t) {
        good = in->command == ID(COMMAND_POSITION) || is_pose(in->equilibrium + 16 * t);
        if (f->c->law == ID(LAW_POTENTIAL)) {
            good = good && is_stiffness(in->translation_stiffness + 9 * t, f->c->translation_stiffness_limit) &&
                   is_stiffness(in->rotation_stiffness + 9 * t, f->c->rotation_stiffness_limit);
        } else {
            good = good && in->command == ID(COMMAND_POSITION) && is_positive_semidefinite(6, in->task_stiffness) &&
                   largest(36, in->task_stiffness) <= f->c->translation_stiffness_limit;
        }
        good = good && (robot_tool(in) == NULL || is_pose(robot_tool(in) + 16 * t));
    }
    return good;
}

/* ---- governor ---- */

/* Largest of the blocks' norms over the governor's part of their limits. */
static double relative(int count, int block, const double *x, const double *limits)
{
    double most = 0.0;
    for (int k = 0; k < count; k += block) {
        most = fmax(most, norm(block, x + k) / (GOVERNOR * limits[k / block]));
    }
    return most;
}

/*
 * New velocity on the way to a wanted point: that of the wanted point, if it is within the limits, and what brings the
 * rest of the way down to zero with a velocity from which the ramp can stop.
 * away: from here to the wanted point, with its motion since the last step, moved, in it.
 */
static void approach(const config_t *c, int count, int block, const double *away, const double *moved,
                     const double *limits, double *velocity)
{
    const double T = c->sample_time, slope = T / c->ramp_time;
    double target[MAX_ROWS] = {0.0}, change[MAX_ROWS] = {0.0}, rest[MAX_ROWS] = {0.0};
    const int follow = relative(count, block, moved, limits) <= T;
    for (int i = 0; i < count; ++i) {
        rest[i] = away[i] - (follow ? moved[i] : 0.0);
    }
    const double way = relative(count, block, rest, limits);
    const double stop = sqrt(0.25 * slope * slope + 2.0 * slope * (way / T)) - 0.5 * slope;
    const double speed = fmin(fmin(way / T, 1.0), stop);
    for (int i = 0; i < count; ++i) {
        target[i] = (follow ? moved[i] / T : 0.0) + (way > 0.0 ? rest[i] * (speed / way) : 0.0);
    }
    const double size = relative(count, block, target, limits);
    for (int i = 0; i < count; ++i) {
        change[i] = target[i] / fmax(size, 1.0) - velocity[i];
    }
    const double jump = relative(count, block, change, limits);
    add(count, jump > slope ? slope / jump : 1.0, change, velocity);
}

/* Twist (hybrid axes) that leads from a pose to another: way of the origin, rotation vector. */
static void difference(const double *from, const double *to, double *twist)
{
    double D[9], *const w = twist + 3;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            D[3 * i + j] = dot(3, to + 4 * i, from + 4 * j);
        }
        twist[i] = to[4 * i + 3] - from[4 * i + 3];
    }
    const double cosine = (D[0] + D[4] + D[8] - 1.0) / 2.0;
    w[0] = (D[7] - D[5]) / 2.0, w[1] = (D[2] - D[6]) / 2.0, w[2] = (D[3] - D[1]) / 2.0;
    double sine = norm(3, w);
    const double angle = atan2(sine, cosine);
    if (sine <= 1e-6 && cosine <= 0.0) {
        /* near half a turn: the axis is the longest column of D + I */
        const int k = D[0] > D[4] ? (D[0] > D[8] ? 0 : 2) : (D[4] > D[8] ? 1 : 2);
        for (int i = 0; i < 3; ++i) {
            w[i] = D[3 * i + k] + (i == k ? 1.0 : 0.0);
        }
        sine = norm(3, w);
    }
    for (int i = 0; i < 3; ++i) {
        w[i] *= sine > 1e-150 ? angle / sine : 1.0;
    }
}

/* Pose moved by a twist (hybrid axes), with its rotation made orthonormal again. */
static void move_pose(const double *pose, const double *twist, double *moved)
{
    const double *const w = twist + 3, W[9] = {0.0, -w[2], w[1], w[2], 0.0, -w[0], -w[1], w[0], 0.0};
    const double angle = norm(3, w), a = angle > 1e-9 ? sin(angle) / angle : 1.0;
    const double b = angle > 1e-9 ? (1.0 - cos(angle)) / (angle * angle) : 0.5;
    double D[9], R[9];
    multiply3(W, 3, 0, W, 3, D);
    for (int k = 0; k < 9; ++k) {
        D[k] = (k % 4 == 0 ? 1.0 : 0.0) + a * W[k] + b * D[k];
    }
    multiply3(D, 3, 0, pose, 4, R);
    multiply3(R, 3, 1, R, 3, D);
    for (int k = 0; k < 9; ++k) {
        D[k] = (k % 4 == 0 ? 1.5 : 0.0) - 0.5 * D[k];
    }
    memcpy(moved, pose, 16 * sizeof(double));
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) { /* R (3 I - R^T R) / 2, symmetric the second factor */
            moved[4 * i + j] = dot(3, R + 3 * i, D + 3 * j);
        }
        moved[4 * i + 3] += twist[i];
    }
}

/* Where a share of this step's way leads: posture and equilibrium. */
static void candidate(const frame *f, double share, int by_posture, double *posture, double *equilibrium)
{
    const memory_t *const m = f->m;
    const double T = share * f->c->sample_time;
    memcpy(posture, m->posture, N * sizeof(double));
    add(N, T, m->posture_velocity, posture);
    if (by_posture) {
        robot_poses(posture, m->tool_pose, equilibrium);
        return;
    }
    for (int t = 0; t < TIPS; ++t) {
        double twist[6] = {0.0};
        add(6, T, m->equilibrium_velocity + 6 * t, twist);
        move_pose(m->equilibrium + 16 * t, twist, equilibrium + 16 * t);
    }
}

/* The velocities wanted now, of posture and equilibrium. Returns whether anything is left to be moved. */
static int want(frame *f, int by_posture)
{
    const config_t *const c = f->c;
    memory_t *const m = f->m;
    const double tip_limits[2] = {c->tip_velocity_limit, c->tip_rotation_limit};
    double away[MAX_ROWS], moved[MAX_ROWS], here[16 * TIPS];
    int moving = 0;
    const int frozen = f->input->command == ID(COMMAND_POSITION) && !by_posture;
    for (int i = 0; i < N; ++i) {
        away[i] = f->commanded && !frozen ? f->input->q0[i] - m->posture[i] : 0.0;
        moved[i] = f->commanded && !frozen ? f->input->q0[i] - m->wanted_posture[i] : 0.0;
        moving |= away[i] != 0.0;
    }
    approach(c, N, 1, away, moved, c->reference_velocity_limit, m->posture_velocity);
    if (by_posture) {
        return moving;
    }
    /* coming from poses: the equilibrium first goes to where the posture has it */
    robot_poses(m->posture, m->tool_pose, here);
    m->joined = frozen && f->commanded;
    for (int t = 0; t < TIPS; ++t) {
        const double *const goal = (frozen ? here : f->input->equilibrium) + 16 * t;
        memset(away, 0, sizeof away);
        memset(moved, 0, sizeof moved);
        if (f->commanded) {
            difference(m->equilibrium + 16 * t, goal, away);
        }
        if (f->commanded && !frozen) {
            difference(m->wanted_equilibrium + 16 * t, goal, moved);
        }
        const int arrived = relative(6, 3, away, tip_limits) <= 1e-12;
        m->joined &= arrived;
        moving |= !arrived;
        approach(c, 6, 3, away, moved, tip_limits, m->equilibrium_velocity + 6 * t);
    }
    return moving;
}

/* The most reference work that the damper's shares on their way can do, the newest, feed, for so many intervals. */
static double worst_feed(const memory_t *m, const double *feed, int intervals)
{
    double sum = 0.0;
    for (int i = 0; i < N; ++i) {
        double size = intervals * fabs(feed[i]);
        for (int k = 0; k < m->delay; ++k) {
            size += fabs(m->feed[k * N + i]);
        }
        sum += farthest(m, i) * size;
    }
    return sum;
}

/*
 * Move the equilibrium towards the wanted one: at bounded velocities, never so that the stored energy passes its limit
 * (where a load holds it above, only if it does not rise), and within the reference work left to the engagement.
 */
static void govern(frame *f)
{
    const config_t *const c = f->c;
    memory_t *const m = f->m;
    const double tip_limits[2] = {c->tip_velocity_limit, c->tip_rotation_limit};
    double posture[N], equilibrium[16 * TIPS], rise = 0.0, share = 1.0;
    if (f->commanded) {
        const int same = memcmp(f->input->q0, m->wanted_posture, N * sizeof(double)) == 0 &&
                         (f->input->command == ID(COMMAND_POSITION) ||
                          memcmp(f->input->equilibrium, m->wanted_equilibrium, sizeof equilibrium) == 0);
        if (!same) {
            m->engagement = c->engagement_limit; /* a new command is a new engagement */
        }
    }
    const int by_posture = m->joined && (!f->commanded || f->input->command == ID(COMMAND_POSITION));
    const int moving = want(f, by_posture);
    const double left = fmax(m->engagement - worst_feed(m, m->feed, c->missed_limit), 0.0);
    const double allowed = fmin(fmax(c->energy_limit - m->elastic_energy, 0.0), left);
    int reached = 0;
    for (int attempt = 0; attempt < 5 && !reached; ++attempt) {
        double speed = 0.0, twist[6];
        candidate(f, share, by_posture, posture, equilibrium);
        for (int t = 0; by_posture && t < TIPS; ++t) {
            difference(m->equilibrium + 16 * t, equilibrium + 16 * t, twist);
            speed = fmax(speed, relative(6, 3, twist, tip_limits) / c->sample_time);
        }
        rise = m->scale * energy_at(m, m->q, equilibrium, posture) - m->elastic_energy;
        reached = speed <= 1.0 && rise <= allowed;
        if (speed > 1.0) {
            share *= (1.0 - 1e-9) / speed;
        } else if (!reached) {
            share *= attempt < 3 && allowed > 0.0 ? 0.9 * allowed / rise : 0.0;
            f->status |= ID(STATUS_GOVERNOR);
        }
    }
    share = reached ? share : 0.0;
    f->status |= moving ? (uint32_t)ID(STATUS_MOVING) : 0u;
    for (int i = 0; i < N; ++i) {
        m->posture_velocity[i] *= share;
    }
    for (int k = 0; k < 6 * TIPS; ++k) {
        m->equilibrium_velocity[k] *= by_posture ? 0.0 : share;
    }
    if (share > 0.0) {
        memcpy(m->posture, posture, sizeof posture);
        memcpy(m->equilibrium, equilibrium, sizeof equilibrium);
        m->elastic_energy += rise;
        book_reference(f, rise);
    }
    if (f->commanded) {
        memcpy(m->wanted_posture, f->input->q0, sizeof posture);
        if (f->input->command == ID(COMMAND_EQUILIBRIUM)) {
            memcpy(m->wanted_equilibrium, f->input->equilibrium, sizeof equilibrium);
            m->joined = 0;
        }
    }
}

/* Set the springs up at the arm, where they store nothing: equilibrium, stiffness, tool and law are free to change. */
static void settle(frame *f)
{
    memory_t *const m = f->m;
    m->law = f->c->law;
    memcpy(m->posture, m->q, sizeof m->posture);
    memset(m->posture_velocity, 0, sizeof m->posture_velocity);
    memset(m->equilibrium_velocity, 0, sizeof m->equilibrium_velocity);
    memcpy(m->posture_stiffness, f->c->posture_stiffness, sizeof m->posture_stiffness);
    m->scale = m->elastic_energy = 0.0;
    m->joined = 1;
    if (f->commanded) {
        if (m->law == ID(LAW_POTENTIAL)) {
            memcpy(m->translation_stiffness, f->input->translation_stiffness, 9 * TIPS * sizeof(double));
            memcpy(m->rotation_stiffness, f->input->rotation_stiffness, 9 * TIPS * sizeof(double));
        } else {
            memset(m->translation_stiffness, 0, 9 * TIPS * sizeof(double));
            memset(m->rotation_stiffness, 0, 9 * TIPS * sizeof(double));
        }
        memcpy(m->wanted_posture, f->input->q0, sizeof m->wanted_posture);
        memcpy(m->wanted_equilibrium, f->input->equilibrium, sizeof m->wanted_equilibrium);
        if (robot_tool(f->input) != NULL) {
            memcpy(m->tool_pose, robot_tool(f->input), sizeof m->tool_pose);
        }
        m->commanded = 1;
    }
    robot_poses(m->q, m->tool_pose, m->equilibrium);
    if (f->commanded && m->fault == ID(FAULT_NONE)) {
        m->engaged = 1;
        m->scale = 1.0;
        /* the engagement's energy first makes up for what the tank lacks */
        if (m->tank < f->c->tank_initial - f->c->engagement_limit) {
            /* it lacks more than an engagement brings in: the account ends here, and begins anew */
            m->unaccounted += 1u;
            m->tank = f->c->tank_initial - f->c->engagement_limit > 0.0 ? m->tank : 0.0;
        }
        const double lack = clamp(f->c->tank_initial - m->tank, 0.0, f->c->engagement_limit);
        m->tank += lack;
        m->engagement = f->c->engagement_limit - lack;
    }
}

/* ---- stiffness ---- */

/* Change the stiffness towards the wanted one: what releases energy is done, what costs some only if the tank can pay. */
static void vary_stiffness(frame *f)
{
    memory_t *const m = f->m;
    const double T = f->c->sample_time, share = 1.0 - exp(-T / f->c->stiffness_time);
    double translation[9 * TIPS], rotation[9 * TIPS], posture[N];
    int changed = 0;
    if (m->law == ID(LAW_PAPER)) {
        memcpy(m->posture_stiffness, f->c->posture_stiffness, sizeof posture);
        return;
    }
    for (int i = 0; i < N; ++i) {
        const double D = f->c->posture_stiffness[i] - m->posture_stiffness[i];
        const double step = fabs(D) <= 1e-9 * f->c->posture_stiffness[i] ? D : share * D;
        posture[i] = step > 0.0 ? step : 0.0;
        m->posture_stiffness[i] += step < 0.0 ? step : 0.0;
        changed |= D != 0.0;
    }
    for (int t = 0; t < TIPS; ++t) {
        double *const Kt = m->translation_stiffness + 9 * t, *const Ko = m->rotation_stiffness + 9 * t;
        changed |= soften(f->commanded ? f->input->translation_stiffness + 9 * t : Kt, share, Kt, translation + 9 * t);
        changed |= soften(f->commanded ? f->input->rotation_stiffness + 9 * t : Ko, share, Ko, rotation + 9 * t);
    }
    if (!changed) {
        return;
    }
    const double released = stored(m, m->q);
    book_stiffness(f, &m->elastic_energy, released - m->elastic_energy);
    double step = 1.0, cost = 0.0;
    for (int attempt = 0; attempt < 2; ++attempt) {
        /* the energy is linear in the stiffness: all of it, and then the share that can be paid */
        add(9 * TIPS, step, translation, m->translation_stiffness);
        add(9 * TIPS, step, rotation, m->rotation_stiffness);
        add(N, step, posture, m->posture_stiffness);
        cost = stored(m, m->q) - released;
        /* nor stiffer than is covered: the scale would take back what was paid */
        const double budget = fmax(fmin(f->budget, cover(m) - m->reserve / COVERED), 0.0);
        if (cost <= budget) {
            break;
        }
        step = (1.0 - 1e-9) * budget / cost - 1.0;
        f->status |= ID(STATUS_TANK_LIMITED);
    }
    book_stiffness(f, &m->elastic_energy, cost);
    f->status |= ID(STATUS_STIFFNESS_CHANGING);
}

/* ---- damping ---- */

/*
 * B = M V diag(b) V^T M + d I, Kq v = lambda M v, V^T M V = I (Albu-Schaeffer and others 2003). b is 2 zeta sqrt(l),
 * l = |lambda| (so that a mode with negative stiffness, which falls, falls slowly), where nothing is late. Held torque
 * and delay act late by h = (delay + 1/2) T: the stiffness takes l h of damping away, the damping b h of inertia, so that
 * zeta = (b - l h) / (2 sqrt(l (1 - b h))) is solved for b.
 * Task design: B = J^T task_damping J + d I. Both capped, but for the paper's law: no eigenvalue of M^-1 B above
 * LARGEST_DAMPING / T. follow (n): torque rate of the moved equilibrium; becomes the velocity of the arm that would follow
 * it at rest. Returns the largest scale that the sample time allows.
 */
static double design_damping(frame *f, double *follow)
{
    const config_t *const c = f->c;
    output_t *const out = f->out;
    double *const L = f->scratch, *const C = L + NN, *const rows = L + 2 * NN;
    double b[N], sum[N] = {0.0}, mass, trace = 0.0, scale = 1.0, largest_b = 0.0, d = c->joint_damping;
    const int paper = f->m->law == ID(LAW_PAPER);
    const double T = c->sample_time, most = paper ? 1e6 : LARGEST_DAMPING / T;
    /* the conventional formula's antisymmetric part has no say in the damping */
    if (pencil(N, out->joint_stiffness, out->mass_matrix, L, C, out->eigenvalues, rows, &mass) != 0) {
        f->status |= ID(STATUS_MASS_MATRIX);
        memset(out->eigenvalues, 0, sizeof out->eigenvalues);
        memset(follow, 0, N * sizeof(double));
        for (int i = 0; i < N; ++i) {
            out->damping[i * (N + 1)] = d;
        }
        return scale;
    }
    const double delayed = 1.0 + 2.0 * c->delay_samples, stiffest = out->eigenvalues[N - 1] * T * T;
    f->status |= out->eigenvalues[0] < 0.0 ? (uint32_t)ID(STATUS_INDEFINITE) : 0u;
    if (stiffest * delayed > LARGEST_STIFFNESS && !paper) {
        scale = LARGEST_STIFFNESS / (stiffest * delayed);
        f->status |= ID(STATUS_STIFFNESS_CAPPED);
    }
    /* trace of M^-1, the sum of the squares in L^-1: joint_damping I is no more than d times that against M */
    for (int k = 0; k < N; ++k) {
        double unit[N] = {0.0};
        unit[k] = 1.0;
        solve_lower(N, 1, L, unit);
        f->brake[k] = mass / dot(N, unit, unit);
        trace += 1.0 / f->brake[k];
    }
    if (d * trace > 0.5 * most) {
        d = 0.5 * most / trace;
        f->status |= ID(STATUS_DAMPING_CAPPED);
    }
    solve_lower(N, 1, L, follow);
    for (int k = 0; k < N; ++k) {
        const double l = out->eigenvalues[k];
        add(N, l > 1e-3 ? dot(N, rows + k * N, follow) / (l * mass) : 0.0, rows + k * N, sum);
    }
    solve_upper(N, L, sum);
    memcpy(follow, sum, sizeof sum);
    if (c->damping_design == ID(DAMPING_DESIGN_TASK)) {
        double J[6 * N * TIPS];
        robot_jacobians(f->m->q, f->m->tool_pose, J);
        for (int k = 0; k < 36 * TIPS; ++k) {
            const double D = (c->task_damping[k % 36] + c->task_damping[k % 6 * 6 + k / 6 % 6]) / 2.0;
            const double *const left = J + k / 6 * N, *const right = J + (k / 36 * 6 + k % 6) * N;
            for (int i = 0; i < NN; ++i) {
                out->damping[i] += left[i / N] * D * right[i % N];
            }
        }
        if (pencil(N, out->damping, out->mass_matrix, L, C, b, rows, &mass) != 0) {
            memset(b, 0, sizeof b);
        }
    } else {
        for (int k = 0; k < N; ++k) {
            const double l = fabs(out->eigenvalues[k]) * scale;
            const double zeta = c->damping_ratio[k], late = (c->delay_samples + 0.5) * T, p = l * late * (2.0 * zeta * zeta - 1.0);
            b[k] = fmax(sqrt(fmax(p * p + 4.0 * zeta * zeta * l - l * l * late * late, 0.0)) - p, l * late);
        }
    }
    int capped = 0;
    for (int k = 0; k < N; ++k) {
        capped |= b[k] > most - d * trace;
        b[k] = clamp(b[k], 0.0, most - d * trace);
        largest_b = fmax(largest_b, b[k]);
        b[k] *= mass;
    }
    f->status |= capped ? (uint32_t)ID(STATUS_DAMPING_CAPPED) : 0u;
    if (capped || c->damping_design == ID(DAMPING_DESIGN_MODAL)) {
        times_lower(N, L, rows);
        congruence(N, rows, b, out->damping);
    }
    for (int i = 0; i < N; ++i) {
        f->brake[i] *= paper ? 0.0 : most - d * trace - largest_b;
        out->damping[i * (N + 1)] += d;
    }
    return scale;
}

/* ---- torque ---- */

/*
 * One quantum of position in a differenced velocity is a torque of B quantum / T. Where that is more than the rate limit
 * lets through, the damping would be lost: the velocity is then the mean of the last few samples.
 */
static void smooth_velocity(frame *f)
{
    const memory_t *const m = f->m;
    double most = 1.0;
    for (int i = 0; f->c->position_quantum > 0.0 && i < N; ++i) {
        double torque = 0.0;
        for (int j = 0; j < N; ++j) {
            torque += fabs(f->out->damping[i * N + j]) * f->c->position_quantum / f->c->sample_time;
        }
        most = fmax(most, torque / m->rate[i]);
    }
    const int wanted = (int)ceil(fmin(most, (double)RECENT));
    const int count = wanted < m->recent_count ? wanted : m->recent_count;
    if (count > 1 && m->gap == 0) {
        for (int i = 0; i < N; ++i) {
            double sum = 0.0;
            for (int k = 0; k < count; ++k) {
                sum += m->recent[k * N + i];
            }
            f->velocity[i] = sum / count;
        }
    }
}

/*
 * A joint that is faster than its reference may be is braked as hard as the sample time allows: modes of different
 * stiffness end a ramp at different times, and near a singularity a short way of the tip is a long one of a joint.
 */
static void brake(frame *f)
{
    double excess[N];
    int fast = 0;
    for (int i = 0; i < N; ++i) {
        const double limit = BRAKED * f->c->reference_velocity_limit[i];
        excess[i] = f->velocity[i] - clamp(f->velocity[i], -limit, limit);
        fast += excess[i] != 0.0;
    }
    for (int i = 0; i < N; ++i) {
        f->out->damping_torque[i] -= excess[i] != 0.0 ? f->brake[i] * excess[i] / fast : 0.0;
    }
}

/* New scale: to zero in a fault, as fast as the torque's rate limit lets; else as far as caps and effort limits allow. */
static void vary_scale(frame *f, const double *last, const double *pull, double energy, double cap)
{
    memory_t *const m = f->m;
    const config_t *const c = f->c;
    double target = cap, fastest_fall = 2.0, parts[3];
    for (int i = 0; i < N; ++i) {
        const double size = fabs(pull[i]);
        if (size > 1e-9) {
            const double limit = pull[i] > 0.0 ? f->out->limit_torque[i] : -f->out->limit_torque[i];
            target = fmin(target, fmax((c->effort_limit[i] - limit) / size, 0.0));
            fastest_fall = fmin(fastest_fall, 0.9 * m->rate[i] / size);
        }
    }
    f->status |= target < cap ? (uint32_t)ID(STATUS_SATURATED) : 0u;
    reserve(f, last, pull, parts);
    const double most = fmax(COVERED * cover(m) - parts[0], 0.0), a = parts[1], b = parts[2];
    if ((a + b * target) * target > most) {
        target = 2.0 * most / (a + sqrt(a * a + 4.0 * b * most));
        f->status |= ID(STATUS_RESERVE);
    }
    if (m->fault != ID(FAULT_NONE)) {
        target = fmax(m->scale - fastest_fall, 0.0);
        if (m->law == ID(LAW_PAPER)) {
            target = 0.0; /* no energy to scale: its torque falls at the rate limit */
        }
    }
    const double rise = target - m->scale;
    double step = fmin(rise, c->sample_time / c->stiffness_time);
    if (step > 0.0 && step * energy > fmax(f->budget, 0.0)) {
        step = (1.0 - 1e-9) * fmax(f->budget, 0.0) / energy;
        f->status |= ID(STATUS_TANK_LIMITED);
    }
    if (step != 0.0) {
        m->scale = step == rise ? target : m->scale + step;
        book_stiffness(f, &m->elastic_energy, m->scale * energy - m->elastic_energy);
    }
}

/* The last guard: finite, within the effort limit (a lowered one comes down at the rate limit), within the rate limit. */
static void limit_torque(frame *f, const double *last)
{
    for (int i = 0; i < N; ++i) {
        const double rate = f->m->rate[i];
        const double effort = fmax(f->c->effort_limit[i], fabs(last[i]) - rate);
        const double wanted = fabs(f->out->torque[i]) <= DBL_MAX ? f->out->torque[i] : 0.0;
        const double possible = clamp(wanted, -effort, effort);
        const double reached = clamp(possible, last[i] - rate, last[i] + rate);
        f->status |= possible != wanted ? (uint32_t)ID(STATUS_SATURATED) : 0u;
        f->status |= reached != possible ? (uint32_t)ID(STATUS_RATE_LIMITED) : 0u;
        f->out->torque[i] = reached;
    }
}

/* Torque with a share of what is wanted: 0 what goes to zero, 1 the springs, 2 with all the damping. Is it covered? */
static int choose(frame *f, const double *last, double share)
{
    output_t *const out = f->out;
    double least[N], parts[3];
    fall(last, f->m->rate, least);
    for (int i = 0; i < N; ++i) {
        const double rate = f->m->rate[i];
        const double springs = clamp(out->elastic_torque[i] + out->limit_torque[i], last[i] - rate, last[i] + rate);
        out->torque[i] = share < 1.0 ? least[i] + share * (springs - least[i])
                                     : out->elastic_torque[i] + out->limit_torque[i] + (share - 1.0) * out->damping_torque[i];
    }
    limit_torque(f, last);
    f->m->reserve = reserve(f, last, out->torque, parts);
    return f->m->reserve <= cover(f->m);
}

/* Torque at the position known last; moved: the governor has moved the equilibrium in this step. */
static void act(frame *f, const double *last, int moved)
{
    const config_t *const c = f->c;
    memory_t *const m = f->m;
    output_t *const out = f->out;
    const int paper = m->law == ID(LAW_PAPER), by_pose = moved && !m->joined && !paper;
    double pull[N], follow[N] = {0.0}, slip[N], feed[N], deflection = 0.0, energy = 0.0, speed = 1.0, share = 2.0;
    robot_mass_matrix(m->q, out->mass_matrix);
    for (int i = 0; i < N; ++i) {
        out->mass_matrix[i * (N + 1)] += c->motor_inertia[i];
        slip[i] = m->posture[i] - m->q[i];
        deflection = fmax(deflection, fabs(slip[i]));
    }
    /* pull = - dU/dq of the springs, unscaled */
    if (paper) {
        memcpy(out->spring_wrench, out->wrench, sizeof out->wrench);
        (c->stiffness_formula == ID(STIFFNESS_FORMULA_CONVENTIONAL) ? robot_conventional_stiffness : robot_joint_stiffness)(
            m->q, m->tool_pose, out->wrench, f->input->task_stiffness, out->joint_stiffness);
        multiply(out->joint_stiffness, slip, pull);
    } else {
        energy = robot_spring(m->q, m->tool_pose, m->equilibrium, m->translation_stiffness, m->rotation_stiffness,
                              out->spring_wrench, pull, out->joint_stiffness);
        energy += robot_posture_energy(m->q, m->posture, m->posture_stiffness);
    }
    if (by_pose) {
        robot_spring_torque(m->q, m->tool_pose, f->old_equilibrium, m->translation_stiffness, m->rotation_stiffness, follow);
    }
    for (int i = 0; i < N; ++i) {
        follow[i] = by_pose ? (pull[i] - follow[i]) / c->sample_time + m->posture_stiffness[i] * m->posture_velocity[i] : 0.0;
        pull[i] += m->posture_stiffness[i] * slip[i];
        out->joint_stiffness[i * (N + 1)] += m->posture_stiffness[i] + f->limit_slope[i];
    }
    const double cap = design_damping(f, follow);
    if (paper && m->engaged && (dot(N, slip, pull) < 0.0 || deflection > PAPER_DEFLECTION)) {
        latch(m, ID(REASON_PAPER_BOUND));
    }
    if (m->engaged) {
        vary_scale(f, last, pull, energy, cap);
    }
    smooth_velocity(f);
    for (int i = 0; i < N; ++i) {
        out->reference_velocity[i] = by_pose ? follow[i] : moved ? m->posture_velocity[i] : 0.0;
        speed = fmax(speed, fabs(out->reference_velocity[i]) / c->reference_velocity_limit[i]);
    }
    for (int i = 0; i < N; ++i) {
        out->reference_velocity[i] /= speed;
        slip[i] = out->reference_velocity[i] - f->velocity[i];
        out->elastic_torque[i] = m->scale * pull[i];
    }
    multiply(out->damping, slip, out->damping_torque);
    brake(f);
    for (int k = 0; k < 6 * TIPS; ++k) {
        out->spring_wrench[k] *= m->scale;
    }
    multiply(out->damping, out->reference_velocity, feed);
    if (worst_feed(m, feed, c->missed_limit) > m->engagement) {
        /* the damper must not do work that is not left: it holds the arm as if the reference stood */
        memset(out->reference_velocity, 0, sizeof out->reference_velocity);
        add(N, -1.0, feed, out->damping_torque);
        memset(feed, 0, sizeof feed);
        f->status |= ID(STATUS_GOVERNOR);
    }
    if (!choose(f, last, share) && !paper) {
        /* what is not covered is not risked: less damping, and, where that is not enough, less of the springs' torque */
        double trial = 1.0;
        share = 0.0;
        for (double step = 0.5; step > 0.01; step *= 0.5) {
            const int covered = choose(f, last, trial);
            share = covered ? trial : share;
            trial += covered ? step : -step;
        }
        choose(f, last, share);
        f->status |= ID(STATUS_RESERVE);
        if (share < 1.0 && m->tank < TANK_FLOOR * c->tank_maximum) {
            latch(m, ID(REASON_RESERVE));
        }
        for (int i = 0; i < N; ++i) {
            out->damping_torque[i] *= fmax(share - 1.0, 0.0);
            feed[i] *= fmax(share - 1.0, 0.0);
        }
    }
    pass(m, last, feed);
}

/* ---- step ---- */

/* A believed sample, or in a fault one whose position is. */
static void sighted(frame *f, const double *last)
{
    const config_t *const c = f->c;
    memory_t *const m = f->m;
    const input_t *const in = f->input;
    int moved = 0;
    if (!m->known) {
        adopt_limits(f, in->q);
    }
    account(f, last, in->q);
    memcpy(m->q, in->q, sizeof m->q);
    memcpy(m->dq, f->velocity, sizeof m->dq);
    m->recent_count = m->gap > 0 ? 1 : m->recent_count < RECENT ? m->recent_count + 1 : RECENT;
    memmove(m->recent + N, m->recent, (RECENT - 1) * N * sizeof(double));
    memcpy(m->recent, f->velocity, N * sizeof(double));
    m->counter = in->counter;
    m->gap = m->missed = 0;
    f->commanded = f->believed && is_command(f);
    f->status |= f->commanded ? 0u : (uint32_t)ID(STATUS_COMMAND_REFUSED);
    for (int i = 0; i < N; ++i) {
        if (fabs(f->velocity[i]) > c->velocity_limit[i]) {
            latch(m, ID(REASON_OVERSPEED));
        }
        /* a lowered limit is what is possible only once the arm is below it */
        if (fmin(fabs(f->velocity[i]), m->velocity_limit[i]) <= c->velocity_limit[i]) {
            m->velocity_limit[i] = c->velocity_limit[i];
        }
        if (in->q[i] < c->lower_limit[i] - c->position_tolerance || in->q[i] > c->upper_limit[i] + c->position_tolerance) {
            latch(m, ID(REASON_POSITION));
        }
    }
    const int other_tool = f->commanded && robot_tool(in) != NULL &&
                           memcmp(robot_tool(in), m->tool_pose, sizeof m->tool_pose) != 0;
    if (m->engaged && (c->law != m->law || other_tool)) {
        latch(m, ID(REASON_CHANGED));
    }
    f->budget = m->tank - TANK_FLOOR * c->tank_maximum;
    if (m->fault == ID(FAULT_NONE)) {
        adopt_limits(f, in->q);
    } else if (m->engaged && m->scale == 0.0) {
        m->engaged = 0;
    }
    if (!m->engaged) {
        m->good_time = f->believed ? m->good_time + c->sample_time : 0.0;
        const int automatic = c->automatic_reset_time > 0.0 && m->good_time >= c->automatic_reset_time;
        if (m->fault != ID(FAULT_NONE) && (m->reset || automatic) && m->good_time > c->sample_time) {
            m->fault = ID(FAULT_NONE);
            m->reason = ID(REASON_NONE);
            m->reset = m->absent = m->bad = 0;
        }
        settle(f);
    } else if (m->fault == ID(FAULT_NONE)) {
        m->reset = 0;
        memcpy(f->old_equilibrium, m->equilibrium, sizeof f->old_equilibrium);
        govern(f);
        vary_stiffness(f);
        moved = 1;
    }
    act(f, last, moved);
}

/* No believed sample: the torque is held, or, where there is a fault, goes to zero as fast as the rate limit lets. */
static void blind(frame *f, const double *last)
{
    memory_t *const m = f->m;
    const double none[N] = {0.0};
    m->missed += m->missed < 1000000 ? 1 : 0;
    bridge(m, last, 1);
    if (m->known && m->fault == ID(FAULT_NONE)) {
        memcpy(f->out->torque, last, N * sizeof(double));
        limit_torque(f, last);
    } else { /* there may be no configuration */
        m->stiffness_total -= m->elastic_energy;
        m->tank += m->elastic_energy;
        m->elastic_energy = m->scale = m->good_time = 0.0;
        fall(last, m->rate, f->out->torque);
    }
    pass(m, last, none);
}

static int step(const config_t *c, state_t *state, const input_t *input, output_t *output)
{
    if (output == NULL) {
        return ID(E_NULL);
    }
    memset(output, 0, sizeof *output);
    output->status = (uint32_t)ID(STATUS_CONFIG) | (uint32_t)ID(STATUS_FAULT);
    output->mode = ID(MODE_FOLLOW);
    output->fault = ID(FAULT_CONFIGURATION);
    output->reason = ID(REASON_CONFIG);
    if (state == NULL) {
        return ID(E_NULL);
    }
    memory_t *const m = &state->memory;
    frame f = {c, m, state->scratch, input, output, 0u, 0, 0, 0, 0, 0.0, {0.0}, {0.0}, {0.0}, {0.0}};
    double last[N], rate[N];
    const int error = c == NULL || input == NULL ? ID(E_NULL) : validate(c);
    majority(state->torque, last);
    majority(state->rate, rate);
    if (state->checksum != checksum(state) || m->ready != READY) {
        if (error != ID(OK) || state->checksum == 0u) {
            fall(last, rate, output->torque);
            keep(state->torque, output->torque);
            return error != ID(OK) ? error : ID(E_NOT_INITIALISED);
        }
        /* memory was overwritten: nothing is believed but the torque, of which there are three */
        begin(c, state);
        m->unaccounted = 1;
        latch(m, ID(REASON_STATE));
    }
    if (error == ID(OK)) {
        for (int i = 0; i < N; ++i) {
            m->rate[i] = c->torque_rate_limit[i] * c->sample_time;
        }
        keep(state->rate, m->rate);
        m->delay = c->delay_samples;
        m->sample_time = c->sample_time;
        m->fault_time += c->sample_time;
        observe(&f, last);
    } else {
        latch(m, ID(REASON_CONFIG));
        f.status |= ID(STATUS_CONFIG);
    }
    if (f.believed || (f.located && m->known && m->fault != ID(FAULT_NONE))) {
        sighted(&f, last);
    } else {
        blind(&f, last);
    }
    keep(state->torque, output->torque);
    remember(m, output);
    memcpy(output->velocity, f.velocity, sizeof output->velocity);
    const int fault = m->fault != ID(FAULT_NONE);
    output->mode = fault ? (m->engaged ? ID(MODE_RELEASE) : ID(MODE_FOLLOW)) : m->engaged ? ID(MODE_ACTIVE) : ID(MODE_START);
    output->status = f.status | (fault ? (uint32_t)ID(STATUS_FAULT) : 0u) |
                     (cover(m) < -1e-9 ? (uint32_t)ID(STATUS_TANK_DEFICIT) : 0u);
    state->checksum = checksum(state);
    return error;
}
