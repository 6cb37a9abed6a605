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
    state_t *state;
    const input_t *input;
    output_t *out;
    uint32_t status;
    int believed;  /* the sample is */
    int located;   /* its position is, which is enough in a fault */
    int jumped;    /* and not where the position known last can have led */
    int commanded; /* the command is accepted */
    double budget; /* of the tank, for what costs */
    double pose[16 * TIPS];
    double old_equilibrium[16 * TIPS];
    double velocity[N];
    double limit_slope[N]; /* of the limit avoidance, where it acts */
    double brake[N];       /* [N m s/rad] that may still be added to the damping of one joint */
} frame;

enum { READY = 0x51f7, RECENT = 8, SAMPLING = 0, REFERENCE, STIFFNESS, PORT, START };

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
    enum { WORDS = sizeof state->memory / sizeof(uint64_t) };
    uint64_t sums[4] = {0x9e3779b97f4a7c15u, 0xc2b2ae3d27d4eb4fu, 0x165667b19e3779f9u, 0x27d4eb2f165667c5u};
    const char *const at = (const char *)&state->memory;
    for (size_t k = 0; k < WORDS; ++k) {
        uint64_t word;
        memcpy(&word, at + k * sizeof word, sizeof word);
        sums[k % 4] = (sums[k % 4] ^ word) * 0x100000001b3u;
    }
    uint64_t sum = 0;
    for (int lane = 0; lane < 4; ++lane) {
        sum = (sum ^ sums[lane] ^ (sums[lane] >> 29)) * 0x9e3779b97f4a7c15u;
    }
    return sum;
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
    memset(&state->memory, 0, sizeof state->memory);
    for (int i = 0; i < N; ++i) {
        state->memory.rate[i] = c->torque_rate_limit[i] * c->sample_time;
    }
    keep(state->rate, state->memory.rate);
    memcpy(state->memory.velocity_limit, c->velocity_limit, sizeof state->memory.velocity_limit);
    state->memory.tank = c->tank_initial;
    state->memory.ready = READY;
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
static void latch(frame *f, int reason)
{
    if (f->state->memory.fault == ID(FAULT_NONE)) {
        f->state->memory.fault = CLASS[reason];
        f->state->memory.reason = reason;
        f->state->memory.fault_time = 0.0;
        f->state->memory.reset = 0;
    }
    f->state->memory.good_time = 0.0;
}

/* ---- springs at poses ---- */

/* U = (p - p0)^T Kt (p - p0) / 2 + tr(G (I - R0^T R)), G = tr(Ko) / 2 I - Ko; its gradient and Hessian where asked for. */
static double tip_spring(const double *pose, const double *equilibrium, const double *Kt, const double *Ko,
                         double *wrench, double *hessian)
{
    double e[3], force[3], G[9], C[9], A[9], energy = 0.0;
    const double half = (Ko[0] + Ko[4] + Ko[8]) / 2.0;
    for (int i = 0; i < 3; ++i) {
        e[i] = pose[4 * i + 3] - equilibrium[4 * i + 3];
        for (int j = 0; j < 3; ++j) {
            G[3 * i + j] = (i == j ? half : 0.0) - Ko[3 * i + j];
        }
    }
    multiply3(equilibrium, 4, 1, pose, 4, C);
    for (int i = 0; i < 3; ++i) {
        force[i] = dot(3, Kt + 3 * i, e);
        energy += 0.5 * e[i] * force[i];
        for (int j = 0; j < 3; ++j) {
            energy += G[3 * i + j] * ((i == j ? 1.0 : 0.0) - C[3 * j + i]);
        }
    }
    if (wrench == NULL) {
        return energy;
    }
    multiply3(pose, 4, 0, G, 3, C);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            A[3 * i + j] = dot(3, C + 3 * i, equilibrium + 4 * j);
        }
        wrench[i] = force[i];
    }
    wrench[3] = A[7] - A[5];
    wrench[4] = A[2] - A[6];
    wrench[5] = A[3] - A[1];
    if (hessian != NULL) {
        const double trace = A[0] + A[4] + A[8];
        memset(hessian, 0, 36 * sizeof(double));
        for (int i = 0; i < 3; ++i) {
            for (int j = 0; j < 3; ++j) {
                hessian[6 * i + j] = Kt[3 * i + j];
                hessian[6 * i + j + 21] = (i == j ? trace : 0.0) - (A[3 * i + j] + A[3 * j + i]) / 2.0;
            }
        }
    }
    return energy;
}

/* U of all springs; the wrenches and Hessians of the tips where asked for. */
static double springs(const frame *f, const double *q, const double *equilibrium, const double *posture, double *wrench,
                      double *hessian)
{
    const int paper = f->state->memory.law == ID(LAW_PAPER);
    double energy = 0.0;
    for (int t = 0; t < TIPS; ++t) {
        energy += tip_spring(f->pose + 16 * t, equilibrium + 16 * t, f->state->memory.translation_stiffness + 9 * t,
                             f->state->memory.rotation_stiffness + 9 * t, wrench != NULL ? wrench + 6 * t : NULL,
                             hessian != NULL ? hessian + 36 * t : NULL);
    }
    for (int i = 0; i < N; ++i) {
        const double e = q[i] - posture[i];
        energy += 0.5 * f->state->memory.posture_stiffness[i] * e * e;
    }
    return paper ? 0.0 : energy; /* the paper's law has none */
}

/* What is stored at q. */
static double stored(const frame *f, const double *q)
{
    return f->state->memory.scale * springs(f, q, f->state->memory.equilibrium, f->state->memory.posture, NULL, NULL);
}

/* result += J^T wrench of all tips. */
static void add_joint_torque(const double *J, const double *wrench, double *result)
{
    for (int k = 0; k < 6 * TIPS; ++k) {
        for (int i = 0; i < N; ++i) {
            result[i] += J[k * N + i] * wrench[k];
        }
    }
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
        const double *const a = f->state->memory.avoidance + 4 * i;
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
    state_t *const s = f->state;
    const double most = fmax(f->c->tank_maximum, s->memory.reserve);
    const double lost = s->memory.tank + income - most;
    s->memory.tank += income;
    if (lost > 0.0) {
        s->memory.tank = most;
        s->memory.engagement = fmin(s->memory.engagement + lost, f->c->engagement_limit);
    }
}

static void book_stiffness(frame *f, double v)
{
    f->state->memory.totals[STIFFNESS] += v;
    f->state->memory.elastic_energy += v;
    f->budget -= v;
    tank_income(f, -v);
}

/* What moving the equilibrium costs is the engagement's; what it gives back, the tank's. */
static void book_reference(frame *f, double p)
{
    f->state->memory.totals[REFERENCE] += p;
    f->state->memory.engagement -= fmax(p, 0.0);
    tank_income(f, fmax(-p, 0.0));
}

/* The torque that acted in the interval that ends now. */
static const double *acting(const state_t *s, const double *last)
{
    return s->memory.delay == 0 ? last : s->memory.older + (s->memory.delay - 1) * N;
}

/* Another interval begins: last is on its way, and the share of the reference in the torque that follows it. */
static void pass(state_t *s, const double *last, const double *feed)
{
    memmove(s->memory.older + N, s->memory.older, N * sizeof(double));
    memcpy(s->memory.older, last, N * sizeof(double));
    memmove(s->memory.feed + N, s->memory.feed, 2 * N * sizeof(double));
    memmove(s->memory.feed, feed, N * sizeof(double));
}

/* Farthest that a joint is taken to move in a sample time. */
static double farthest(const state_t *s, int i)
{
    return fmax(s->memory.velocity_limit[i], fabs(s->memory.dq[i])) * s->memory.sample_time;
}

/*
 * What the torques on their way can put out, whatever the environment does, until the last of them has gone to zero at the
 * rate limit: no joint faster than its limit, and only one of m = missed_limit calls made. The torque is held for m such
 * calls without a sample, and, in a fault, for one.
 */
static double reserve(const frame *f, const double *last, const double *torque)
{
    const state_t *const s = f->state;
    const double m = f->c->missed_limit, held = s->memory.fault != ID(FAULT_NONE) ? 1.0 : m;
    double sum = 0.0;
    for (int i = 0; i < N; ++i) {
        const double size = fabs(torque[i]);
        const double way = (s->memory.delay > 0 ? fabs(last[i]) : 0.0) + (s->memory.delay > 1 ? fabs(s->memory.older[i]) : 0.0);
        sum += farthest(s, i) * (m * (held * size + 0.5 * size * (size / s->memory.rate[i])) + way);
    }
    return sum;
}

/* What there is for it. */
static double cover(const state_t *s)
{
    return s->memory.tank + s->memory.elastic_energy + s->memory.limit_energy;
}

/*
 * Take on the configured limit avoidance of each joint whose change stores no more at q than the tank's budget pays; else
 * the old one stays. A first sample is free.
 */
static void adopt_limits(frame *f, const double *q)
{
    const config_t *const c = f->c;
    state_t *const s = f->state;
    for (int i = 0; i < N; ++i) {
        double *const a = s->memory.avoidance + 4 * i;
        const double wanted[4] = {c->lower_limit[i] + c->limit_zone, c->upper_limit[i] - c->limit_zone,
                                  c->limit_stiffness[i], c->effort_limit[i]};
        if (memcmp(a, wanted, sizeof wanted) == 0) {
            continue;
        }
        if (s->memory.known) {
            double pull, slope;
            const double v = avoidance(wanted, q[i], &pull, &slope) - avoidance(a, q[i], &pull, &slope);
            if (!(v <= fmax(f->budget, 0.0))) {
                f->status |= ID(STATUS_LIMITS_KEPT);
                continue;
            }
            s->memory.totals[STIFFNESS] += v;
            s->memory.limit_energy += v;
            f->budget -= v;
            tank_income(f, -v);
        }
        memcpy(a, wanted, sizeof wanted);
    }
    avoid_limits(f, q);
}

/*
 * Intervals without a believed position. Two bounds on their work: that of the last one's torque over the whole way and,
 * at every change of torque, the change over the way that can have been gone before it; or every torque over its own way.
 */
static void bridge(state_t *s, const double *last, int periods)
{
    const double *const torque = acting(s, last);
    if (s->memory.gap == 0) {
        s->memory.gap_work = 0.0;
        s->memory.gap_most = 0.0;
        memcpy(s->memory.gap_torque, torque, N * sizeof(double));
    }
    for (int i = 0; i < N; ++i) {
        s->memory.gap_work += fabs(torque[i] - s->memory.gap_torque[i]) * farthest(s, i) * s->memory.gap;
        s->memory.gap_most += fabs(torque[i]) * farthest(s, i) * periods;
    }
    memcpy(s->memory.gap_torque, torque, N * sizeof(double));
    s->memory.gap = s->memory.gap < 1000000 - periods ? s->memory.gap + periods : 1000000;
}

/*
 * Energy that the interval up to the believed position q has put in. The damper lies between the arm and the moving
 * reference: what its share for the reference, feed = B dr, does on the arm's way is the reference's work. The account
 * begins, or begins anew, where the position has no known way to.
 */
static void account(frame *f, const double *last, const double *q)
{
    state_t *const s = f->state;
    double work = 0.0, feed = 0.0, way[N];
    const double elastic = stored(f, q), limit = avoid_limits(f, q);
    const double rise = elastic - s->memory.elastic_energy + limit - s->memory.limit_energy;
    s->memory.elastic_energy = elastic;
    s->memory.limit_energy = limit;
    if (!s->memory.known || f->jumped) {
        s->memory.totals[START] += rise;
        s->memory.unaccounted += (uint32_t)s->memory.known;
        s->memory.known = 1;
        return;
    }
    for (int i = 0; i < N; ++i) {
        way[i] = q[i] - s->memory.q[i];
    }
    if (s->memory.gap > 0) {
        bridge(s, last, 1);
        work = fmin(s->memory.gap_work + dot(N, s->memory.gap_torque, way), s->memory.gap_most);
    } else {
        work = dot(N, acting(s, last), way);
        feed = fmax(dot(N, s->memory.feed + s->memory.delay * N, way), 0.0);
    }
    s->memory.totals[PORT] += work;
    s->memory.totals[SAMPLING] += rise + work - feed;
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
    state_t *const s = f->state;
    const int count = s->memory.absent + (periods > 0 ? 2 * periods : -1), limit = 2 * f->c->missed_limit;
    s->memory.absent = count < 0 ? 0 : count < limit ? count : limit;
    if (count >= limit && s->memory.known) {
        latch(f, reason);
    }
}

enum { FROZEN_POSITION = 1, FROZEN_VELOCITY = 2 };

/* Whether q or dq of a joint stands still while the other moves, over a window; and what they are compared with next. */
static int frozen(const config_t *c, state_t *s, const double *q, const double *dq, int i)
{
    const int first = !s->memory.known;
    const double window = c->frozen_window, T = c->sample_time, elapsed = T * (1 + s->memory.gap);
    const double way = fmax(4.0 * c->position_quantum, 0.02 * s->memory.velocity_limit[i] * window * T);
    if (first || q[i] != s->memory.still_q[i]) {
        s->memory.still_q[i] = q[i];
        s->memory.travelled[i] = s->memory.q_age[i] = 0.0;
    } else {
        s->memory.travelled[i] += dq[i] * elapsed;
        s->memory.q_age[i] += 1.0;
    }
    if (first || dq[i] != s->memory.still_dq[i]) {
        s->memory.still_dq[i] = dq[i];
        s->memory.start_q[i] = q[i];
        s->memory.dq_age[i] = 0.0;
    } else {
        s->memory.start_q[i] += dq[i] * elapsed;
        s->memory.dq_age[i] += 1.0;
    }
    return (s->memory.q_age[i] >= window && fabs(s->memory.travelled[i]) > way ? FROZEN_POSITION : 0) |
           (s->memory.dq_age[i] >= window && fabs(q[i] - s->memory.start_q[i]) > way ? FROZEN_VELOCITY : 0);
}

/*
 * REASON_NONE, or why the sample is not believed. A sample whose position alone is credible still serves in a fault: the
 * velocity is then the other signal's, or, where it is open which of the two is wrong, the smaller one if they agree in
 * sign: damping with too small a velocity puts no energy in.
 */
static int doubt(frame *f, const double *last)
{
    const config_t *const c = f->c;
    state_t *const s = f->state;
    const input_t *const in = f->input;
    int reason = ID(REASON_NONE);
    for (int i = 0; i < N; ++i) {
        if (!(fabs(in->q[i]) <= FARTHEST && fabs(in->dq[i]) <= 1e3 * s->memory.velocity_limit[i])) {
            return ID(REASON_NOT_FINITE);
        }
    }
    if (s->memory.known) {
        const int32_t ahead = (int32_t)(in->counter - s->memory.counter - (uint32_t)s->memory.gap - 1u);
        const int regular = in->counter == s->memory.seen_counter + 1u;
        s->memory.regular = regular ? (s->memory.regular < 3 ? s->memory.regular + 1 : 3) : 0;
        s->memory.seen_counter = in->counter;
        if (ahead < 0 && (s->memory.fault == ID(FAULT_NONE) || s->memory.regular < 3)) {
            return ID(REASON_STALE);
        }
        if (ahead > 0) {
            f->status |= ID(STATUS_MISSED);
            if (s->memory.gap > 0) { /* between which of the calls without a sample is not known */
                s->memory.gap_work = HUGE_VAL;
                s->memory.gap_most *= fmin(1.0 + ahead, c->missed_limit);
            }
            for (int k = 0; k < ahead && k < 3; ++k) { /* the torque of the last call was held */
                bridge(s, last, 1);
                pass(s, last, s->memory.feed);
            }
            bridge(s, last, ahead < 3 ? 0 : ahead < 1000000 ? ahead - 3 : 1000000);
            absent(f, ahead < 1000 ? ahead : 1000, ID(REASON_SKIPPED));
        }
    }
    const double elapsed = c->sample_time * (1 + s->memory.gap);
    /* an arm that is too fast must be braked: in a fault q and dq that agree are believed at any speed */
    const int fault = s->memory.fault != ID(FAULT_NONE);
    f->located = 1;
    f->jumped = 0;
    for (int i = 0; i < N; ++i) {
        const double way = s->memory.known ? in->q[i] - s->memory.q[i] : in->dq[i] * elapsed;
        const double far = s->memory.velocity_limit[i] * elapsed, measured = way / elapsed;
        const int still = frozen(c, s, in->q, in->dq, i);
        const int differ =
            fabs(in->dq[i] * elapsed - way) > fmax(0.5 * far, 0.3 * fabs(way)) + 2.0 * c->position_quantum;
        f->velocity[i] = in->dq[i];
        if (differ && fabs(way) > 2.0 * far + 2.0 * c->position_quantum) {
            f->velocity[i] = 0.0;
            f->jumped = 1;
            reason = ID(REASON_JUMP);
        } else if (still != 0) {
            f->velocity[i] = still == FROZEN_VELOCITY ? measured : in->dq[i];
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

/* Largest of the blocks' norms over their limits. */
static double relative(int count, int block, const double *x, const double *limits)
{
    double most = 0.0;
    for (int k = 0; k < count; k += block) {
        most = fmax(most, norm(block, x + k) / limits[k / block]);
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
    for (int i = 0; i < count; ++i) {
        velocity[i] += change[i] * (jump > slope ? slope / jump : 1.0);
    }
}

/* Rotation vector, base axes, of the turn from R0 to R; poses with row length 4. */
static void rotation_vector(const double *R0, const double *R, double *w)
{
    double D[9];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            D[3 * i + j] = dot(3, R + 4 * i, R0 + 4 * j);
        }
    }
    const double x[3] = {(D[7] - D[5]) / 2.0, (D[2] - D[6]) / 2.0, (D[3] - D[1]) / 2.0};
    const double s = norm(3, x), cosine = (D[0] + D[4] + D[8] - 1.0) / 2.0, angle = atan2(s, cosine);
    if (s > 1e-6 || cosine > 0.0) {
        for (int i = 0; i < 3; ++i) {
            w[i] = s > 1e-150 ? x[i] * (angle / s) : x[i];
        }
        return;
    }
    /* near half a turn: the axis is the longest column of D + I */
    int longest = 0;
    for (int j = 1; j < 3; ++j) {
        longest = D[4 * j] > D[4 * longest] ? j : longest;
    }
    for (int i = 0; i < 3; ++i) {
        w[i] = D[3 * i + longest] + (i == longest ? 1.0 : 0.0);
    }
    const double size = norm(3, w);
    for (int i = 0; i < 3; ++i) {
        w[i] *= angle / size;
    }
}

/* Pose moved by a twist (hybrid axes), with its rotation made orthonormal again. */
static void move_pose(const double *pose, const double *twist, double *moved)
{
    const double *const w = twist + 3;
    const double angle = norm(3, w), a = angle > 1e-9 ? sin(angle) / angle : 1.0;
    const double b = angle > 1e-9 ? (1.0 - cos(angle)) / (angle * angle) : 0.5;
    double D[9], R[9], turned[9];
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            D[3 * i + j] = (i == j ? 1.0 - b * angle * angle : 0.0) + b * w[i] * w[j];
        }
    }
    D[1] -= a * w[2], D[2] += a * w[1], D[3] += a * w[2], D[5] -= a * w[0], D[6] -= a * w[1], D[7] += a * w[0];
    multiply3(D, 3, 0, pose, 4, R);
    multiply3(R, 3, 1, R, 3, D); /* R (3 I - R^T R) / 2 */
    for (int i = 0; i < 9; ++i) {
        D[i] = (i % 4 == 0 ? 1.5 : 0.0) - 0.5 * D[i];
    }
    multiply3(R, 3, 0, D, 3, turned);
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            moved[4 * i + j] = turned[3 * i + j];
        }
        moved[4 * i + 3] = pose[4 * i + 3] + twist[i];
        moved[12 + i] = 0.0;
    }
    moved[15] = 1.0;
}

static void difference(const double *from, const double *to, double *twist)
{
    for (int i = 0; i < 3; ++i) {
        twist[i] = to[4 * i + 3] - from[4 * i + 3];
    }
    rotation_vector(from, to, twist + 3);
}

/* Where a share of this step's way leads: posture and equilibrium. */
static void candidate(const frame *f, double share, int by_posture, double *posture, double *equilibrium)
{
    const double T = f->c->sample_time;
    for (int i = 0; i < N; ++i) {
        posture[i] = f->state->memory.posture[i] + share * T * f->state->memory.posture_velocity[i];
    }
    if (by_posture) {
        robot_poses(posture, f->state->memory.tool_pose, equilibrium);
        return;
    }
    for (int t = 0; t < TIPS; ++t) {
        double twist[6];
        for (int k = 0; k < 6; ++k) {
            twist[k] = share * T * f->state->memory.equilibrium_velocity[6 * t + k];
        }
        move_pose(f->state->memory.equilibrium + 16 * t, twist, equilibrium + 16 * t);
    }
}

/* The velocities wanted now, of posture and equilibrium. Returns whether anything is left to be moved. */
static int want(frame *f, int by_posture)
{
    const config_t *const c = f->c;
    state_t *const s = f->state;
    const double tip_limits[2] = {GOVERNOR * c->tip_velocity_limit, GOVERNOR * c->tip_rotation_limit};
    double away[MAX_ROWS], moved[MAX_ROWS], goal[16 * TIPS], limits[N];
    int moving = 0;
    const int frozen = f->input->command == ID(COMMAND_POSITION) && !by_posture;
    for (int i = 0; i < N; ++i) {
        away[i] = f->commanded && !frozen ? f->input->q0[i] - s->memory.posture[i] : 0.0;
        moved[i] = f->commanded && !frozen ? f->input->q0[i] - s->memory.wanted_posture[i] : 0.0;
        moving |= away[i] != 0.0;
        limits[i] = GOVERNOR * c->reference_velocity_limit[i];
    }
    approach(c, N, 1, away, moved, limits, s->memory.posture_velocity);
    if (by_posture) {
        return moving;
    }
    if (frozen) {
        /* coming from poses: the equilibrium first goes to where the posture has it */
        robot_poses(s->memory.posture, s->memory.tool_pose, goal);
    } else {
        memcpy(goal, f->input->equilibrium, sizeof goal);
    }
    for (int t = 0; t < TIPS; ++t) {
        memset(away, 0, sizeof away);
        memset(moved, 0, sizeof moved);
        if (f->commanded) {
            difference(s->memory.equilibrium + 16 * t, goal + 16 * t, away);
            if (!frozen) {
                difference(s->memory.wanted_equilibrium + 16 * t, goal + 16 * t, moved);
            }
        }
        const int arrived = relative(6, 3, away, tip_limits) <= 1e-12;
        moving |= !arrived;
        if (frozen && arrived && t == 0) {
            s->memory.joined = 1;
        } else if (!arrived) {
            s->memory.joined = 0;
        }
        approach(c, 6, 3, away, moved, tip_limits, s->memory.equilibrium_velocity + 6 * t);
    }
    return moving;
}

/* The most reference work that the damper's shares on their way can do, the newest, feed, for so many intervals. */
static double worst_feed(const state_t *s, const double *feed, int intervals)
{
    double sum = 0.0;
    for (int i = 0; i < N; ++i) {
        double size = intervals * fabs(feed[i]);
        for (int k = 0; k < s->memory.delay; ++k) {
            size += fabs(s->memory.feed[k * N + i]);
        }
        sum += farthest(s, i) * size;
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
    state_t *const s = f->state;
    const double T = c->sample_time, tip_limits[2] = {GOVERNOR * c->tip_velocity_limit * T, GOVERNOR * c->tip_rotation_limit * T};
    double posture[N], equilibrium[16 * TIPS], rise = 0.0, share = 1.0;
    if (f->commanded) {
        const int same = memcmp(f->input->q0, s->memory.wanted_posture, N * sizeof(double)) == 0 &&
                         (f->input->command == ID(COMMAND_POSITION) ||
                          memcmp(f->input->equilibrium, s->memory.wanted_equilibrium, sizeof equilibrium) == 0);
        if (!same) {
            s->memory.engagement = c->engagement_limit; /* a new command is a new engagement */
        }
    }
    const int by_posture = s->memory.joined && (!f->commanded || f->input->command == ID(COMMAND_POSITION));
    const int moving = want(f, by_posture);
    const double left = fmax(s->memory.engagement - worst_feed(s, s->memory.feed, c->missed_limit), 0.0);
    const double allowed = fmin(fmax(c->energy_limit - s->memory.elastic_energy, 0.0), left);
    for (int attempt = 0; attempt < 5 && share > 0.0; ++attempt) {
        candidate(f, share, by_posture, posture, equilibrium);
        double speed = 0.0, twist[6];
        for (int t = 0; by_posture && t < TIPS; ++t) {
            difference(s->memory.equilibrium + 16 * t, equilibrium + 16 * t, twist);
            speed = fmax(speed, relative(6, 3, twist, tip_limits));
        }
        if (speed > 1.0) {
            share *= (1.0 - 1e-9) / speed;
            continue;
        }
        rise = s->memory.scale * springs(f, f->state->memory.q, equilibrium, posture, NULL, NULL) - s->memory.elastic_energy;
        if (rise <= allowed) {
            break;
        }
        f->status |= ID(STATUS_GOVERNOR);
        share *= attempt < 3 && allowed > 0.0 ? 0.9 * allowed / rise : 0.0;
    }
    f->status |= moving ? (uint32_t)ID(STATUS_MOVING) : 0u;
    for (int i = 0; i < N; ++i) {
        s->memory.posture_velocity[i] *= share;
    }
    for (int k = 0; k < 6 * TIPS; ++k) {
        s->memory.equilibrium_velocity[k] *= by_posture ? 0.0 : share;
    }
    if (share > 0.0) {
        memcpy(s->memory.posture, posture, sizeof posture);
        memcpy(s->memory.equilibrium, equilibrium, sizeof equilibrium);
        s->memory.elastic_energy += rise;
        book_reference(f, rise);
    }
    if (f->commanded) {
        memcpy(s->memory.wanted_posture, f->input->q0, sizeof posture);
        if (f->input->command == ID(COMMAND_EQUILIBRIUM)) {
            memcpy(s->memory.wanted_equilibrium, f->input->equilibrium, sizeof equilibrium);
            s->memory.joined = 0;
        }
    }
}

/* Set the springs up at the arm, where they store nothing: equilibrium, stiffness, tool and law are free to change. */
static void settle(frame *f)
{
    state_t *const s = f->state;
    s->memory.law = f->c->law;
    memcpy(s->memory.posture, s->memory.q, sizeof s->memory.posture);
    memset(s->memory.posture_velocity, 0, sizeof s->memory.posture_velocity);
    memset(s->memory.equilibrium_velocity, 0, sizeof s->memory.equilibrium_velocity);
    memcpy(s->memory.posture_stiffness, f->c->posture_stiffness, sizeof s->memory.posture_stiffness);
    s->memory.scale = 0.0;
    s->memory.elastic_energy = 0.0;
    s->memory.joined = 1;
    if (f->commanded) {
        if (s->memory.law == ID(LAW_POTENTIAL)) {
            memcpy(s->memory.translation_stiffness, f->input->translation_stiffness, 9 * TIPS * sizeof(double));
            memcpy(s->memory.rotation_stiffness, f->input->rotation_stiffness, 9 * TIPS * sizeof(double));
        } else {
            memset(s->memory.translation_stiffness, 0, 9 * TIPS * sizeof(double));
            memset(s->memory.rotation_stiffness, 0, 9 * TIPS * sizeof(double));
        }
        memcpy(s->memory.wanted_posture, f->input->q0, sizeof s->memory.wanted_posture);
        memcpy(s->memory.wanted_equilibrium, f->input->equilibrium, sizeof s->memory.wanted_equilibrium);
        if (robot_tool(f->input) != NULL) {
            memcpy(s->memory.tool_pose, robot_tool(f->input), sizeof s->memory.tool_pose);
        }
        s->memory.commanded = 1;
    }
    robot_poses(s->memory.q, s->memory.tool_pose, f->pose);
    memcpy(s->memory.equilibrium, f->pose, sizeof f->pose);
    if (f->commanded && s->memory.fault == ID(FAULT_NONE)) {
        s->memory.engaged = 1;
        s->memory.scale = 1.0;
        /* the engagement's energy first makes up for what the tank lacks */
        if (s->memory.tank < f->c->tank_initial - f->c->engagement_limit) {
            /* it lacks more than an engagement brings in: the account ends here, and begins anew */
            s->memory.unaccounted += 1u;
            s->memory.tank = f->c->tank_initial - f->c->engagement_limit > 0.0 ? s->memory.tank : 0.0;
        }
        const double lack = clamp(f->c->tank_initial - s->memory.tank, 0.0, f->c->engagement_limit);
        s->memory.tank += lack;
        s->memory.engagement = f->c->engagement_limit - lack;
    }
}

/* ---- stiffness ---- */

/* Matrices of a spring: cost = the part of share (wanted - K) that stiffens, the rest of it is done at once. */
static int soften(const double *wanted, double share, double *K, double *cost)
{
    double D[9], S[9], work[27], size = 0.0;
    for (int i = 0; i < 9; ++i) {
        D[i] = wanted[i] - K[i];
        S[i] = wanted[i] + K[i];
        size += fabs(D[i]);
    }
    memset(cost, 0, 9 * sizeof(double));
    if (size == 0.0) {
        return 0;
    }
    const double trace = S[0] + S[4] + S[8];
    for (int i = 0; i < 9; i += 4) {
        S[i] += 1e-10 * trace; /* directions without stiffness before and after */
    }
    if (positive_part(3, D, S, cost, work) != 0) {
        memset(cost, 0, 9 * sizeof(double));
        return 0;
    }
    const int last = size <= 1e-9 * trace;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j <= i; ++j) {
            const double released = (last ? 1.0 : share) * ((D[3 * i + j] + D[3 * j + i]) / 2.0 - cost[3 * i + j]);
            cost[3 * i + j] *= last ? 1.0 : share;
            cost[3 * j + i] = cost[3 * i + j];
            K[3 * i + j] += released;
            K[3 * j + i] = K[3 * i + j];
        }
    }
    return 1;
}

/* Change the stiffness towards the wanted one: what releases energy is done, what costs some only if the tank can pay. */
static void vary_stiffness(frame *f)
{
    state_t *const s = f->state;
    const double T = f->c->sample_time, share = 1.0 - exp(-T / f->c->stiffness_time);
    double translation[9 * TIPS], rotation[9 * TIPS], posture[N];
    int changed = 0;
    if (s->memory.law == ID(LAW_PAPER)) {
        memcpy(s->memory.posture_stiffness, f->c->posture_stiffness, sizeof posture);
        return;
    }
    for (int i = 0; i < N; ++i) {
        const double D = f->c->posture_stiffness[i] - s->memory.posture_stiffness[i];
        const double step = fabs(D) <= 1e-9 * f->c->posture_stiffness[i] ? D : share * D;
        posture[i] = step > 0.0 ? step : 0.0;
        s->memory.posture_stiffness[i] += step < 0.0 ? step : 0.0;
        changed |= D != 0.0;
    }
    for (int t = 0; t < TIPS; ++t) {
        const int read = f->commanded;
        double *const Kt = s->memory.translation_stiffness + 9 * t, *const Ko = s->memory.rotation_stiffness + 9 * t;
        changed |= soften(read ? f->input->translation_stiffness + 9 * t : Kt, share, Kt, translation + 9 * t);
        changed |= soften(read ? f->input->rotation_stiffness + 9 * t : Ko, share, Ko, rotation + 9 * t);
    }
    if (!changed) {
        return;
    }
    const double before = s->memory.elastic_energy;
    const double released = stored(f, s->memory.q);
    book_stiffness(f, released - before);
    double portion = 1.0, cost = 0.0;
    for (int attempt = 0; attempt < 2; ++attempt) {
        /* the energy is linear in the stiffness: all of it, and then the share that can be paid */
        const double step = attempt == 0 ? 1.0 : portion - 1.0;
        for (int k = 0; k < 9 * TIPS; ++k) {
            s->memory.translation_stiffness[k] += step * translation[k];
            s->memory.rotation_stiffness[k] += step * rotation[k];
        }
        for (int i = 0; i < N; ++i) {
            s->memory.posture_stiffness[i] += step * posture[i];
        }
        cost = stored(f, s->memory.q) - released;
        /* nor stiffer than is covered: the scale would take back what was paid */
        const double budget = fmax(fmin(f->budget, cover(s) - s->memory.reserve / COVERED), 0.0);
        if (cost <= budget) {
            break;
        }
        portion = (1.0 - 1e-9) * budget / cost;
        f->status |= ID(STATUS_TANK_LIMITED);
    }
    book_stiffness(f, cost);
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
static double design_damping(frame *f, const double *J, double *follow)
{
    const config_t *const c = f->c;
    output_t *const out = f->out;
    double *const L = f->state->scratch, *const C = L + NN, *const rows = L + 2 * NN;
    double b[N], sum[N] = {0.0}, mass, trace = 0.0, scale = 1.0, d = c->joint_damping;
    const int paper = f->state->memory.law == ID(LAW_PAPER);
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
        solve_lower(N, L, unit);
        f->brake[k] = mass / dot(N, unit, unit);
        trace += 1.0 / f->brake[k];
    }
    if (d * trace > 0.5 * most) {
        d = 0.5 * most / trace;
        f->status |= ID(STATUS_DAMPING_CAPPED);
    }
    solve_lower(N, L, follow);
    for (int k = 0; k < N; ++k) {
        const double l = out->eigenvalues[k];
        const double a = l > 1e-3 ? dot(N, rows + k * N, follow) / (l * mass) : 0.0;
        for (int i = 0; i < N; ++i) {
            sum[i] += a * rows[k * N + i];
        }
    }
    solve_upper(N, L, sum);
    memcpy(follow, sum, sizeof sum);
    if (c->damping_design == ID(DAMPING_DESIGN_TASK)) {
        for (int i = 0; i < NN; ++i) {
            for (int k = 0; k < 36; ++k) {
                const double D = (c->task_damping[k] + c->task_damping[k % 6 * 6 + k / 6]) / 2.0;
                out->damping[i] += J[k / 6 * N + i / N] * D * J[k % 6 * N + i % N];
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
    double largest_b = 0.0;
    for (int k = 0; k < N; ++k) {
        capped |= b[k] > most - d * trace;
        b[k] = clamp(b[k], 0.0, most - d * trace);
        largest_b = fmax(largest_b, b[k]);
    }
    for (int i = 0; i < N; ++i) {
        f->brake[i] *= paper ? 0.0 : most - d * trace - largest_b;
    }
    f->status |= capped ? (uint32_t)ID(STATUS_DAMPING_CAPPED) : 0u;
    if (capped || c->damping_design == ID(DAMPING_DESIGN_MODAL)) {
        times_lower(N, L, rows);
        for (int k = 0; k < N; ++k) {
            b[k] *= mass;
        }
        congruence(N, rows, b, out->damping);
    }
    for (int i = 0; i < N; ++i) {
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
    const state_t *const s = f->state;
    double most = 1.0;
    for (int i = 0; f->c->position_quantum > 0.0 && i < N; ++i) {
        double torque = 0.0;
        for (int j = 0; j < N; ++j) {
            torque += fabs(f->out->damping[i * N + j]) * f->c->position_quantum / f->c->sample_time;
        }
        most = fmax(most, torque / s->memory.rate[i]);
    }
    const int wanted = (int)ceil(fmin(most, (double)RECENT));
    const int count = wanted < s->memory.recent_count ? wanted : s->memory.recent_count;
    if (count > 1 && s->memory.gap == 0) {
        for (int i = 0; i < N; ++i) {
            double sum = 0.0;
            for (int k = 0; k < count; ++k) {
                sum += s->memory.recent[k * N + i];
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
    state_t *const s = f->state;
    const config_t *const c = f->c;
    double target = cap, fastest_fall = 2.0;
    for (int i = 0; i < N; ++i) {
        const double size = fabs(pull[i]);
        if (size > 1e-9) {
            const double limit = pull[i] > 0.0 ? f->out->limit_torque[i] : -f->out->limit_torque[i];
            target = fmin(target, fmax((c->effort_limit[i] - limit) / size, 0.0));
            fastest_fall = fmin(fastest_fall, 0.9 * s->memory.rate[i] / size);
        }
    }
    f->status |= target < cap ? (uint32_t)ID(STATUS_SATURATED) : 0u;
    /* the reserve of l times the torque is quadratic in l */
    double half[N], none[N] = {0.0};
    for (int i = 0; i < N; ++i) {
        half[i] = 0.5 * pull[i];
    }
    const double least = reserve(f, last, none), all = reserve(f, last, pull) - least;
    const double b = 2.0 * all - 4.0 * (reserve(f, last, half) - least), a = all - b;
    const double most = fmax(COVERED * cover(s) - least, 0.0);
    if ((a + b * target) * target > most) {
        target = 2.0 * most / (a + sqrt(a * a + 4.0 * b * most));
        f->status |= ID(STATUS_RESERVE);
    }
    if (s->memory.fault != ID(FAULT_NONE)) {
        target = fmax(s->memory.scale - fastest_fall, 0.0);
        if (s->memory.law == ID(LAW_PAPER)) {
            target = 0.0; /* no energy to scale: its torque falls at the rate limit */
        }
    }
    const double rise = target - s->memory.scale;
    double step = fmin(rise, c->sample_time / c->stiffness_time);
    if (step > 0.0 && step * energy > fmax(f->budget, 0.0)) {
        step = (1.0 - 1e-9) * fmax(f->budget, 0.0) / energy;
        f->status |= ID(STATUS_TANK_LIMITED);
    }
    if (step != 0.0) {
        s->memory.scale = step == rise ? target : s->memory.scale + step;
        book_stiffness(f, s->memory.scale * energy - s->memory.elastic_energy);
    }
}

/* The last guard: finite, within the effort limit (a lowered one comes down at the rate limit), within the rate limit. */
static void limit_torque(frame *f, const double *last)
{
    for (int i = 0; i < N; ++i) {
        const double rate = f->state->memory.rate[i];
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
    double least[N];
    fall(last, f->state->memory.rate, least);
    for (int i = 0; i < N; ++i) {
        const double rate = f->state->memory.rate[i];
        const double springs = clamp(out->elastic_torque[i] + out->limit_torque[i], last[i] - rate, last[i] + rate);
        out->torque[i] = share < 1.0 ? least[i] + share * (springs - least[i])
                                     : out->elastic_torque[i] + out->limit_torque[i] + (share - 1.0) * out->damping_torque[i];
    }
    limit_torque(f, last);
    f->state->memory.reserve = reserve(f, last, out->torque);
    return f->state->memory.reserve <= cover(f->state);
}

/* Torque at the position known last; moved: the governor has moved the equilibrium in this step. */
static void act(frame *f, const double *last, int moved)
{
    const config_t *const c = f->c;
    state_t *const s = f->state;
    output_t *const out = f->out;
    const double *const q = s->memory.q;
    const int paper = s->memory.law == ID(LAW_PAPER);
    double J[6 * N * TIPS], hessian[36 * TIPS], pull[N], follow[N] = {0.0}, slip[N], feed[N];
    robot_mass_matrix(q, out->mass_matrix);
    for (int i = 0; i < N; ++i) {
        out->mass_matrix[i * (N + 1)] += c->motor_inertia[i];
    }
    robot_jacobians(q, s->memory.tool_pose, J);
    const double energy = springs(f, q, s->memory.equilibrium, s->memory.posture, out->spring_wrench, hessian);
    if (paper) {
        memcpy(out->spring_wrench, out->wrench, sizeof out->wrench);
        (c->stiffness_formula == ID(STIFFNESS_FORMULA_CONVENTIONAL) ? robot_conventional_stiffness : robot_joint_stiffness)(
            q, s->memory.tool_pose, out->wrench, f->input->task_stiffness, out->joint_stiffness);
    } else {
        robot_joint_stiffness(q, s->memory.tool_pose, out->spring_wrench, hessian, out->joint_stiffness);
    }
    /* pull = - dU/dq of the springs, unscaled */
    memset(pull, 0, sizeof pull);
    if (!paper) {
        add_joint_torque(J, out->spring_wrench, pull);
    }
    double deflection = 0.0;
    for (int i = 0; i < N; ++i) {
        slip[i] = s->memory.posture[i] - q[i];
        deflection = fmax(deflection, fabs(slip[i]));
        pull[i] = s->memory.posture_stiffness[i] * slip[i] - pull[i];
    }
    if (paper) {
        for (int i = 0; i < N; ++i) {
            pull[i] += dot(N, out->joint_stiffness + i * N, slip);
        }
    }
    for (int i = 0; i < N; ++i) {
        out->joint_stiffness[i * (N + 1)] += s->memory.posture_stiffness[i] + f->limit_slope[i];
    }
    const int by_pose = moved && !s->memory.joined && !paper;
    if (by_pose) {
        double wrench[6 * TIPS];
        springs(f, q, f->old_equilibrium, s->memory.posture, wrench, NULL);
        for (int k = 0; k < 6 * TIPS; ++k) {
            wrench[k] = (wrench[k] - out->spring_wrench[k]) / c->sample_time;
        }
        for (int i = 0; i < N; ++i) {
            follow[i] = s->memory.posture_stiffness[i] * s->memory.posture_velocity[i];
        }
        add_joint_torque(J, wrench, follow);
    }
    const double cap = design_damping(f, J, follow);
    if (paper && s->memory.engaged && (dot(N, slip, pull) < 0.0 || deflection > PAPER_DEFLECTION)) {
        latch(f, ID(REASON_PAPER_BOUND));
    }
    if (s->memory.engaged) {
        vary_scale(f, last, pull, energy, cap);
    }
    smooth_velocity(f);
    double speed = 1.0;
    for (int i = 0; i < N; ++i) {
        out->reference_velocity[i] = by_pose ? follow[i] : moved ? s->memory.posture_velocity[i] : 0.0;
        speed = fmax(speed, fabs(out->reference_velocity[i]) / c->reference_velocity_limit[i]);
    }
    for (int i = 0; i < N; ++i) {
        out->reference_velocity[i] /= speed;
        slip[i] = out->reference_velocity[i] - f->velocity[i];
        out->elastic_torque[i] = s->memory.scale * pull[i];
    }
    multiply(out->damping, slip, out->damping_torque);
    brake(f);
    for (int k = 0; k < 6 * TIPS; ++k) {
        out->spring_wrench[k] *= s->memory.scale;
    }
    multiply(out->damping, out->reference_velocity, feed);
    if (worst_feed(s, feed, c->missed_limit) > s->memory.engagement) {
        /* the damper must not do work that is not left: it holds the arm as if the reference stood */
        memset(out->reference_velocity, 0, sizeof out->reference_velocity);
        for (int i = 0; i < N; ++i) {
            out->damping_torque[i] -= feed[i];
            feed[i] = 0.0;
        }
        f->status |= ID(STATUS_GOVERNOR);
    }
    double share = 2.0;
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
        if (share < 1.0 && s->memory.tank < TANK_FLOOR * c->tank_maximum) {
            latch(f, ID(REASON_RESERVE));
        }
        for (int i = 0; i < N; ++i) {
            out->damping_torque[i] *= fmax(share - 1.0, 0.0);
            feed[i] *= fmax(share - 1.0, 0.0);
        }
    }
    pass(s, last, feed);
}

/* ---- step ---- */

/* A believed sample, or in a fault one whose position is. */
static void sighted(frame *f, const double *last)
{
    const config_t *const c = f->c;
    state_t *const s = f->state;
    const input_t *const in = f->input;
    int moved = 0;
    robot_poses(in->q, s->memory.commanded || robot_tool(in) == NULL ? s->memory.tool_pose : robot_tool(in), f->pose);
    if (!s->memory.known) {
        adopt_limits(f, in->q);
    }
    account(f, last, in->q);
    memcpy(s->memory.q, in->q, sizeof s->memory.q);
    memcpy(s->memory.dq, f->velocity, sizeof s->memory.dq);
    s->memory.recent_count = s->memory.gap > 0 ? 1 : s->memory.recent_count < RECENT ? s->memory.recent_count + 1 : RECENT;
    memmove(s->memory.recent + N, s->memory.recent, (RECENT - 1) * N * sizeof(double));
    memcpy(s->memory.recent, f->velocity, N * sizeof(double));
    s->memory.counter = in->counter;
    s->memory.gap = 0;
    s->memory.missed = 0;
    f->commanded = f->believed && is_command(f);
    f->status |= f->commanded ? 0u : (uint32_t)ID(STATUS_COMMAND_REFUSED);
    for (int i = 0; i < N; ++i) {
        if (fabs(f->velocity[i]) > c->velocity_limit[i]) {
            latch(f, ID(REASON_OVERSPEED));
        }
        /* a lowered limit is what is possible only once the arm is below it */
        if (fmin(fabs(f->velocity[i]), s->memory.velocity_limit[i]) <= c->velocity_limit[i]) {
            s->memory.velocity_limit[i] = c->velocity_limit[i];
        }
        if (in->q[i] < c->lower_limit[i] - c->position_tolerance || in->q[i] > c->upper_limit[i] + c->position_tolerance) {
            latch(f, ID(REASON_POSITION));
        }
    }
    const int other_tool = f->commanded && robot_tool(in) != NULL &&
                           memcmp(robot_tool(in), s->memory.tool_pose, sizeof s->memory.tool_pose) != 0;
    if (s->memory.engaged && (c->law != s->memory.law || other_tool)) {
        latch(f, ID(REASON_CHANGED));
    }
    f->budget = s->memory.tank - TANK_FLOOR * c->tank_maximum;
    if (s->memory.fault == ID(FAULT_NONE)) {
        adopt_limits(f, in->q);
    } else if (s->memory.engaged && s->memory.scale == 0.0) {
        s->memory.engaged = 0;
    }
    if (!s->memory.engaged) {
        s->memory.good_time = f->believed ? s->memory.good_time + c->sample_time : 0.0;
        const int automatic = c->automatic_reset_time > 0.0 && s->memory.good_time >= c->automatic_reset_time;
        if (s->memory.fault != ID(FAULT_NONE) && (s->memory.reset || automatic) && s->memory.good_time > c->sample_time) {
            s->memory.fault = ID(FAULT_NONE);
            s->memory.reason = ID(REASON_NONE);
            s->memory.reset = s->memory.absent = s->memory.bad = 0;
        }
        settle(f);
    } else if (s->memory.fault == ID(FAULT_NONE)) {
        s->memory.reset = 0;
        memcpy(f->old_equilibrium, s->memory.equilibrium, sizeof f->old_equilibrium);
        govern(f);
        vary_stiffness(f);
        moved = 1;
    }
    act(f, last, moved);
}

/* No believed sample: the torque is held, or, where there is a fault, goes to zero as fast as the rate limit lets. */
static void blind(frame *f, const double *last)
{
    state_t *const s = f->state;
    const double none[N] = {0.0};
    s->memory.missed += s->memory.missed < 1000000 ? 1 : 0;
    bridge(s, last, 1);
    if (s->memory.known && s->memory.fault == ID(FAULT_NONE)) {
        memcpy(f->out->torque, last, N * sizeof(double));
        limit_torque(f, last);
    } else { /* there may be no configuration */
        s->memory.totals[STIFFNESS] -= s->memory.elastic_energy;
        s->memory.tank += s->memory.elastic_energy;
        s->memory.elastic_energy = s->memory.scale = s->memory.good_time = 0.0;
        fall(last, s->memory.rate, f->out->torque);
    }
    pass(s, last, none);
}

static void report(frame *f)
{
    const state_t *const s = f->state;
    output_t *const out = f->out;
    memcpy(out->position, s->memory.q, sizeof out->position);
    memcpy(out->velocity, f->velocity, sizeof out->velocity);
    memcpy(out->reference, s->memory.posture, sizeof out->reference);
    memcpy(out->equilibrium, s->memory.equilibrium, sizeof out->equilibrium);
    memcpy(out->translation_stiffness, s->memory.translation_stiffness, sizeof out->translation_stiffness);
    memcpy(out->rotation_stiffness, s->memory.rotation_stiffness, sizeof out->rotation_stiffness);
    out->scale = s->memory.scale;
    out->elastic_energy = s->memory.elastic_energy;
    out->limit_energy = s->memory.limit_energy;
    out->tank_energy = s->memory.tank;
    out->tank_reserve = s->memory.reserve;
    out->engagement = s->memory.engagement;
    out->sampling_total = s->memory.totals[SAMPLING];
    out->reference_total = s->memory.totals[REFERENCE];
    out->stiffness_total = s->memory.totals[STIFFNESS];
    out->port_total = s->memory.totals[PORT];
    out->start_total = s->memory.totals[START];
    out->fault = s->memory.fault;
    out->reason = s->memory.reason;
    out->fault_time = s->memory.fault_time;
    out->missed = s->memory.missed;
    out->unaccounted = s->memory.unaccounted;
    const int fault = s->memory.fault != ID(FAULT_NONE);
    out->mode = fault ? (s->memory.engaged ? ID(MODE_RELEASE) : ID(MODE_FOLLOW))
                      : (s->memory.engaged ? ID(MODE_ACTIVE) : ID(MODE_START));
    f->status |= fault ? (uint32_t)ID(STATUS_FAULT) : 0u;
    f->status |= cover(s) < -1e-9 ? (uint32_t)ID(STATUS_TANK_DEFICIT) : 0u;
    out->status = f->status;
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
    frame f = {c, state, input, output, 0u, 0, 0, 0, 0, 0.0, {0.0}, {0.0}, {0.0}, {0.0}, {0.0}};
    double last[N], rate[N];
    int error = c == NULL || input == NULL ? ID(E_NULL) : validate(c);
    const int intact = state->checksum == checksum(state) && state->memory.ready == READY;
    majority(state->torque, last);
    majority(state->rate, rate);
    if (!intact) {
        if (error != ID(OK) || state->checksum == 0u) {
            fall(last, rate, output->torque);
            keep(state->torque, output->torque);
            return error != ID(OK) ? error : ID(E_NOT_INITIALISED);
        }
        /* memory was overwritten: nothing is believed but the torque, of which there are three */
        begin(c, state);
        state->memory.unaccounted = 1;
        latch(&f, ID(REASON_STATE));
    }
    if (error == ID(OK)) {
        for (int i = 0; i < N; ++i) {
            state->memory.rate[i] = c->torque_rate_limit[i] * c->sample_time;
        }
        keep(state->rate, state->memory.rate);
        state->memory.delay = c->delay_samples;
        state->memory.sample_time = c->sample_time;
        const int valid = input->sample_valid == 1;
        if (valid) {
            observe_wrench(&f);
        }
        const int reason = valid ? doubt(&f, last) : ID(REASON_MISSED);
        state->memory.fault_time += c->sample_time;
        f.believed = reason == ID(REASON_NONE);
        if (f.believed) {
            state->memory.bad = (state->memory.bad << 1) & 7;
            absent(&f, 0, reason);
        } else {
            f.status |= valid ? (uint32_t)ID(STATUS_BAD_SAMPLE) : (uint32_t)ID(STATUS_MISSED);
            if (valid) {
                state->memory.bad = ((state->memory.bad << 1) | 1) & 7;
                if ((state->memory.bad & (state->memory.bad - 1)) != 0) {
                    latch(&f, reason);
                }
            }
            absent(&f, 1, reason);
        }
        if (f.believed || (f.located && state->memory.known && state->memory.fault != ID(FAULT_NONE))) {
            sighted(&f, last);
        } else {
            blind(&f, last);
        }
    } else {
        latch(&f, ID(REASON_CONFIG));
        f.status |= ID(STATUS_CONFIG);
        blind(&f, last);
    }
    keep(state->torque, output->torque);
    report(&f);
    state->checksum = checksum(state);
    return error;
}
