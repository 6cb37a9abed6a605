/*
 * The impedance controller's step, for one robot. NAME_impedance.c includes this once, after it has defined
 *   N                 number of coordinates (a constant)
 *   ROBOT(function)   the robot's kernel of that name
 *   config_t, state_t, input_t, output_t   its structs (NAME_impedance.h documents their fields)
 *
 * Order of a step: missed sample? -> believable sample? -> mode and reference -> wrench filter -> target stiffness
 * -> energy account of the interval that ended -> stiffness rate limit -> tank -> damping -> torques -> effort limit
 * -> rate limit. docs/controller.md has the equations.
 *
 * The torque that a step returns is taken to be held until the next step. The account of an interval is therefore made
 * at its end, from the torques of the step before and the positions of both, and is exact for any motion in between:
 *   -port = change of (V + V_limit) + dissipated - variation - sampling - antisymmetric - limiting.
 */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

#if defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__
#error "compile without -ffast-math and -ffinite-math-only: NaN and infinity must be seen"
#endif

enum { READY = 0x51f7, NN = N * N };

static int is_finite(double x)
{
    return fabs(x) <= DBL_MAX;
}

static int all_finite(int count, const double *x)
{
    for (int i = 0; i < count; ++i) {
        if (!is_finite(x[i])) {
            return 0;
        }
    }
    return 1;
}

static int within(double x, double least, double most)
{
    return x >= least && x <= most;
}

static int all_positive(const double *x)
{
    for (int i = 0; i < N; ++i) {
        if (!(x[i] > 0.0 && x[i] <= DBL_MAX)) {
            return 0;
        }
    }
    return 1;
}

static double clamp(double x, double least, double most)
{
    return x < least ? least : x > most ? most : x;
}

static double dot(const double *a, const double *b)
{
    double sum = 0.0;
    for (int i = 0; i < N; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

/* 1/2 x^T A x */
static double half_form(const double *A, const double *x)
{
    double sum = 0.0;
    for (int i = 0; i < N; ++i) {
        sum += x[i] * dot(A + i * N, x);
    }
    return 0.5 * sum;
}

static void multiply(const double *A, const double *x, double *result)
{
    for (int i = 0; i < N; ++i) {
        result[i] = dot(A + i * N, x);
    }
}

static double norm3(const double *x)
{
    return sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
}

/* ---- configuration ------------------------------------------------------------------------------------------- */

static int validate_stiffness(const config_t *c)
{
    if (!within(c->representation, STIFFGEN_REPRESENTATION_BODY, STIFFGEN_REPRESENTATION_HYBRID)) {
        return STIFFGEN_E_CONFIG_REPRESENTATION;
    }
    const int conventional = c->stiffness_formula == STIFFGEN_STIFFNESS_FORMULA_CONVENTIONAL;
    if (!conventional && c->stiffness_formula != STIFFGEN_STIFFNESS_FORMULA_CORRECTED) {
        return STIFFGEN_E_CONFIG_STIFFNESS_FORMULA;
    }
    const int positive = c->stiffness_sign == STIFFGEN_STIFFNESS_SIGN_POSITIVE_PART;
    if ((!positive && c->stiffness_sign != STIFFGEN_STIFFNESS_SIGN_AS_IS) || (positive && conventional)) {
        return STIFFGEN_E_CONFIG_STIFFNESS_SIGN;
    }
    if (!(c->stiffness_rate_limit > 0.0 && is_finite(c->stiffness_rate_limit))) {
        return STIFFGEN_E_CONFIG_STIFFNESS_RATE;
    }
    if (!within(c->nullspace, STIFFGEN_NULLSPACE_OFF, STIFFGEN_NULLSPACE_PROJECTED)) {
        return STIFFGEN_E_CONFIG_NULLSPACE;
    }
    const int wanted = c->nullspace != STIFFGEN_NULLSPACE_OFF;
    if (!(wanted ? c->nullspace_stiffness > 0.0 : c->nullspace_stiffness == 0.0) ||
        !is_finite(c->nullspace_stiffness)) {
        return STIFFGEN_E_CONFIG_NULLSPACE_STIFFNESS;
    }
    if (!within(c->singularity_threshold, 1e-9, 1.0)) {
        return STIFFGEN_E_CONFIG_SINGULARITY_THRESHOLD;
    }
    if (!(c->task_stiffness_limit > 0.0 && c->task_stiffness_limit <= 1e9)) {
        return STIFFGEN_E_CONFIG_TASK_STIFFNESS_LIMIT;
    }
    if (!within(c->tank, STIFFGEN_TANK_OFF, STIFFGEN_TANK_ON) || (conventional && c->tank == STIFFGEN_TANK_ON)) {
        return STIFFGEN_E_CONFIG_TANK;
    }
    if (!(c->tank_minimum >= 0.0 && c->tank_minimum <= c->tank_initial && c->tank_initial <= c->tank_maximum &&
          is_finite(c->tank_maximum))) {
        return STIFFGEN_E_CONFIG_TANK_ENERGY;
    }
    return within(c->tank_refill, 0.0, 1.0) ? STIFFGEN_OK : STIFFGEN_E_CONFIG_TANK_REFILL;
}

static int validate_damping(const config_t *c)
{
    if (!within(c->damping_design, STIFFGEN_DAMPING_DESIGN_MODAL, STIFFGEN_DAMPING_DESIGN_TASK)) {
        return STIFFGEN_E_CONFIG_DAMPING_DESIGN;
    }
    for (int i = 0; i < N; ++i) {
        if (!within(c->damping_ratio[i], 0.0, 100.0)) {
            return STIFFGEN_E_CONFIG_DAMPING_RATIO;
        }
    }
    if (!stiffgen_is_positive_semidefinite6(c->task_damping)) {
        return STIFFGEN_E_CONFIG_TASK_DAMPING;
    }
    for (int i = 0; i < 36 && c->damping_design != STIFFGEN_DAMPING_DESIGN_TASK; ++i) {
        if (c->task_damping[i] != 0.0) {
            return STIFFGEN_E_CONFIG_TASK_DAMPING;
        }
    }
    return c->joint_damping >= 0.0 && is_finite(c->joint_damping) ? STIFFGEN_OK : STIFFGEN_E_CONFIG_JOINT_DAMPING;
}

static int validate_limits(const config_t *c)
{
    if (!all_positive(c->velocity_limit)) {
        return STIFFGEN_E_CONFIG_VELOCITY_LIMIT;
    }
    if (!all_positive(c->effort_limit)) {
        return STIFFGEN_E_CONFIG_EFFORT_LIMIT;
    }
    if (!all_positive(c->torque_rate_limit)) {
        return STIFFGEN_E_CONFIG_TORQUE_RATE_LIMIT;
    }
    if (!(c->force_limit > 0.0 && is_finite(c->force_limit) && c->moment_limit > 0.0 && is_finite(c->moment_limit))) {
        return STIFFGEN_E_CONFIG_WRENCH_LIMITS;
    }
    if (!(c->position_tolerance >= 0.0 && is_finite(c->position_tolerance))) {
        return STIFFGEN_E_CONFIG_POSITION_TOLERANCE;
    }
    if (!(c->limit_zone > 0.0 && is_finite(c->limit_zone))) {
        return STIFFGEN_E_CONFIG_LIMIT_ZONE;
    }
    for (int i = 0; i < N; ++i) {
        if (!(c->lower_limit[i] < c->upper_limit[i])) {
            return STIFFGEN_E_CONFIG_POSITION_LIMITS;
        }
        if (!(c->upper_limit[i] - c->lower_limit[i] > 2.0 * c->limit_zone)) {
            return STIFFGEN_E_CONFIG_LIMIT_ZONE;
        }
        if (!(c->limit_stiffness[i] >= 0.0 && is_finite(c->limit_stiffness[i]))) {
            return STIFFGEN_E_CONFIG_LIMIT_STIFFNESS;
        }
    }
    return STIFFGEN_OK;
}

static int validate(const config_t *c)
{
    if (!(c->sample_time > 0.0 && c->sample_time <= 0.1)) {
        return STIFFGEN_E_CONFIG_SAMPLE_TIME;
    }
    if (!within(c->wrench_filter, STIFFGEN_WRENCH_FILTER_OFF, STIFFGEN_WRENCH_FILTER_MOVING_AVERAGE)) {
        return STIFFGEN_E_CONFIG_WRENCH_FILTER;
    }
    if (!(c->wrench_time_constant > 0.0 && is_finite(c->wrench_time_constant))) {
        return STIFFGEN_E_CONFIG_WRENCH_TIME_CONSTANT;
    }
    if (!within(c->wrench_window, 1, STIFFGEN_MAX_WINDOW)) {
        return STIFFGEN_E_CONFIG_WRENCH_WINDOW;
    }
    if (!within(c->missed_limit, 1, 1000)) {
        return STIFFGEN_E_CONFIG_MISSED_LIMIT;
    }
    if (!(c->velocity_decay_time > 0.0 && is_finite(c->velocity_decay_time))) {
        return STIFFGEN_E_CONFIG_VELOCITY_DECAY_TIME;
    }
    if (!(c->return_time >= 0.0 && is_finite(c->return_time))) {
        return STIFFGEN_E_CONFIG_RETURN_TIME;
    }
    int error = validate_stiffness(c);
    error = error != STIFFGEN_OK ? error : validate_damping(c);
    return error != STIFFGEN_OK ? error : validate_limits(c);
}

static int initialise(const config_t *config, state_t *state)
{
    if (config == NULL || state == NULL) {
        return STIFFGEN_E_NULL;
    }
    memset(state, 0, sizeof *state);
    const int error = validate(config);
    if (error != STIFFGEN_OK) {
        return error;
    }
    output_t *const last = &state->last;
    for (int i = 0; i < N; ++i) {
        last->damping[i * N + i] = config->joint_damping;
        state->torque_step[i] = config->torque_rate_limit[i] * config->sample_time;
    }
    last->mode = STIFFGEN_MODE_START;
    last->tank_energy = config->tank_initial;
    state->ready = READY;
    return STIFFGEN_OK;
}

/* ---- input --------------------------------------------------------------------------------------------------- */

/* Status bits of a vector of positions; positions beyond their limits are believed up to the tolerance. */
static unsigned check_position(const config_t *c, const double *q)
{
    if (!all_finite(N, q)) {
        return STIFFGEN_STATUS_NON_FINITE;
    }
    for (int i = 0; i < N; ++i) {
        /* 1e6 also bounds joints without limits: beyond it an angle has lost its last digits. */
        if (q[i] < c->lower_limit[i] - c->position_tolerance || q[i] > c->upper_limit[i] + c->position_tolerance ||
            fabs(q[i]) > 1e6) {
            return STIFFGEN_STATUS_OUT_OF_RANGE;
        }
    }
    return 0;
}

static unsigned check_velocity(const config_t *c, const double *dq)
{
    if (!all_finite(N, dq)) {
        return STIFFGEN_STATUS_NON_FINITE;
    }
    for (int i = 0; i < N; ++i) {
        if (fabs(dq[i]) > c->velocity_limit[i]) {
            return STIFFGEN_STATUS_OUT_OF_RANGE;
        }
    }
    return 0;
}

static unsigned check_task(const config_t *c, const input_t *input)
{
    unsigned status = 0;
    if (!all_finite(6, input->wrench)) {
        status |= STIFFGEN_STATUS_NON_FINITE;
    } else if (!(norm3(input->wrench) <= c->force_limit && norm3(input->wrench + 3) <= c->moment_limit)) {
        status |= STIFFGEN_STATUS_OUT_OF_RANGE;
    }
    if (!all_finite(36, input->task_stiffness)) {
        return status | STIFFGEN_STATUS_NON_FINITE;
    }
    for (int i = 0; i < 36; ++i) {
        if (fabs(input->task_stiffness[i]) > c->task_stiffness_limit) {
            status |= STIFFGEN_STATUS_OUT_OF_RANGE;
        }
    }
    return stiffgen_is_positive_semidefinite6(input->task_stiffness) ? status : status | STIFFGEN_STATUS_TASK_STIFFNESS;
}

static void filter_wrench(const config_t *c, state_t *state, const double *raw, double *filtered)
{
    const int first = state->wrench_count == 0;
    if (c->wrench_filter == STIFFGEN_WRENCH_FILTER_MOVING_AVERAGE) {
        /* The sum is taken anew over the raw samples: no drift, and no filtered value among them. */
        memcpy(state->wrench_samples + 6 * state->wrench_next, raw, 6 * sizeof(double));
        state->wrench_next = (state->wrench_next + 1) % STIFFGEN_MAX_WINDOW;
        state->wrench_count += state->wrench_count < STIFFGEN_MAX_WINDOW ? 1 : 0;
        const int count = state->wrench_count < c->wrench_window ? state->wrench_count : c->wrench_window;
        for (int k = 0; k < 6; ++k) {
            double sum = 0.0;
            for (int s = 1; s <= count; ++s) {
                const int slot = (state->wrench_next - s + STIFFGEN_MAX_WINDOW) % STIFFGEN_MAX_WINDOW;
                sum += state->wrench_samples[6 * slot + k];
            }
            filtered[k] = sum / count;
        }
        return;
    }
    const int direct = first || c->wrench_filter == STIFFGEN_WRENCH_FILTER_OFF;
    const double weight = direct ? 1.0 : -expm1(-c->sample_time / c->wrench_time_constant);
    for (int k = 0; k < 6; ++k) {
        filtered[k] = direct ? raw[k] : filtered[k] + weight * (raw[k] - filtered[k]);
    }
    state->wrench_count = 1;
}

/* ---- stiffness and damping ----------------------------------------------------------------------------------- */

static void kernels_stiffness(const config_t *c, const double *q, const double *wrench, const double *K, double *result)
{
    const int corrected = c->stiffness_formula == STIFFGEN_STIFFNESS_FORMULA_CORRECTED;
    if (c->representation == STIFFGEN_REPRESENTATION_BODY) {
        (corrected ? ROBOT(body_joint_stiffness) : ROBOT(body_joint_stiffness_uncorrected))(q, wrench, K, result);
    } else if (c->representation == STIFFGEN_REPRESENTATION_SPATIAL) {
        (corrected ? ROBOT(spatial_joint_stiffness) : ROBOT(spatial_joint_stiffness_uncorrected))(q, wrench, K, result);
    } else {
        (corrected ? ROBOT(hybrid_joint_stiffness) : ROBOT(hybrid_joint_stiffness_uncorrected))(q, wrench, K, result);
    }
}

static void kernels_jacobian(const config_t *c, const double *q, double *J)
{
    if (c->representation == STIFFGEN_REPRESENTATION_BODY) {
        ROBOT(body_jacobian)(q, J);
    } else if (c->representation == STIFFGEN_REPRESENTATION_SPATIAL) {
        ROBOT(spatial_jacobian)(q, J);
    } else {
        ROBOT(hybrid_jacobian)(q, J);
    }
}

/* Joint stiffness of the sample with nullspace stiffness into output->stiffness_target; returns status bits. */
static unsigned target_stiffness(const config_t *c, state_t *state, const input_t *input, const double *J,
                                 output_t *output)
{
    double *const K = output->stiffness_target, *const extra = state->scratch, *const work = state->scratch + NN;
    unsigned status = 0;
    int error = STIFFGEN_OK;
    kernels_stiffness(c, input->q, output->wrench, input->task_stiffness, K);
    output->singularity = 0.0;
    if (c->nullspace == STIFFGEN_NULLSPACE_ISOTROPIC) {
        for (int i = 0; i < N; ++i) {
            K[i * N + i] += c->nullspace_stiffness;
        }
    } else if (c->nullspace == STIFFGEN_NULLSPACE_PROJECTED) {
        error = stiffgen_nullspace_stiffness(N, J, output->mass_matrix, c->nullspace_stiffness,
                                             c->singularity_threshold, extra, &output->singularity, work);
        if (error == STIFFGEN_OK) {
            for (int i = 0; i < NN; ++i) {
                K[i] += extra[i];
            }
            status |= output->singularity < c->singularity_threshold ? (unsigned)STIFFGEN_STATUS_SINGULAR : 0u;
        }
    }
    if (error == STIFFGEN_OK && c->stiffness_sign == STIFFGEN_STIFFNESS_SIGN_POSITIVE_PART) {
        error = stiffgen_positive_part(N, K, output->mass_matrix, extra, output->eigenvalues, work);
        if (error == STIFFGEN_OK) {
            memcpy(K, extra, NN * sizeof(double));
        }
    }
    if (error != STIFFGEN_OK) {
        output->singularity = 0.0;
        memcpy(K, state->last.stiffness_target, NN * sizeof(double));
        status |= STIFFGEN_STATUS_MASS_MATRIX;
    }
    return status;
}

/* Bq and eigenvalues for the applied stiffness; returns status bits. On an error both stay those of the last step. */
static unsigned design_damping(const config_t *c, state_t *state, const double *J, output_t *output)
{
    double *const B = state->scratch, *const K = state->scratch + NN, *const work = state->scratch + 2 * NN;
    double values[N];
    int error;
    double asymmetry = 0.0;
    for (int i = 0; i < N; ++i) {
        for (int j = 0; j <= i; ++j) {
            const double a = output->stiffness[i * N + j], b = output->stiffness[j * N + i];
            K[i * N + j] = K[j * N + i] = i == j ? a : (a + b) / 2.0;
            asymmetry += i == j ? 0.0 : (a - b) * (a - b) / 2.0;
        }
    }
    output->antisymmetric_norm = sqrt(asymmetry);
    if (c->damping_design == STIFFGEN_DAMPING_DESIGN_MODAL) {
        error = stiffgen_damping_modal(N, K, output->mass_matrix, c->damping_ratio, B, values, work);
    } else {
        error = stiffgen_eigen_generalised(N, K, output->mass_matrix, values, B, work);
        if (c->damping_design == STIFFGEN_DAMPING_DESIGN_TASK) {
            /* needs no mass matrix: a singular one costs the eigenvalues only */
            const int failed = stiffgen_damping_task(N, J, c->task_damping, 0.0, B);
            for (int i = 0; failed == STIFFGEN_OK && i < NN; ++i) {
                output->damping[i] = B[i] + (i % (N + 1) == 0 ? c->joint_damping : 0.0);
            }
        } else if (error == STIFFGEN_OK) {
            error = stiffgen_damping_factorised(N, K, output->mass_matrix, c->damping_ratio, B, work);
            if (error == STIFFGEN_OK) {
                double discarded[N];
                error = stiffgen_positive_part(N, B, NULL, K, discarded, work);
                memcpy(B, K, NN * sizeof(double));
            }
        }
    }
    if (error != STIFFGEN_OK) {
        return STIFFGEN_STATUS_MASS_MATRIX;
    }
    if (c->damping_design != STIFFGEN_DAMPING_DESIGN_TASK) {
        for (int i = 0; i < NN; ++i) {
            output->damping[i] = B[i] + (i % (N + 1) == 0 ? c->joint_damping : 0.0);
        }
    }
    memcpy(output->eigenvalues, values, sizeof values);
    /* J^T K J alone has zero eigenvalues, which come out as roundings of either sign. */
    return values[0] < -1e-9 * fabs(values[N - 1]) ? STIFFGEN_STATUS_INDEFINITE : 0;
}

/* ---- torques -------------------------------------------------------------------------------------------------- */

/* Torque that grows with the depth d in the limit zone, -k d, from the potential k d^2 / 2; returns status bits. */
static unsigned avoid_limits(const config_t *c, const double *q, output_t *output)
{
    unsigned status = 0;
    output->limit_energy = 0.0;
    for (int i = 0; i < N; ++i) {
        const double above = q[i] - (c->upper_limit[i] - c->limit_zone);
        const double below = q[i] - (c->lower_limit[i] + c->limit_zone);
        const double depth = above > 0.0 ? above : below < 0.0 ? below : 0.0;
        output->limit_torque[i] = -c->limit_stiffness[i] * depth;
        output->limit_energy += 0.5 * c->limit_stiffness[i] * depth * depth;
        status |= depth != 0.0 ? (unsigned)STIFFGEN_STATUS_JOINT_LIMIT : 0u;
    }
    return status;
}

/* Sum of the torques, cut to the effort limits, then moved from the last torque by no more than the rate limit. */
static unsigned command(const config_t *c, state_t *state, output_t *output)
{
    unsigned status = 0;
    for (int i = 0; i < N; ++i) {
        const double wanted = output->elastic_torque[i] + output->damping_torque[i] + output->limit_torque[i];
        const double effort = c->effort_limit[i], step = c->torque_rate_limit[i] * c->sample_time;
        const double last = state->last.torque[i];
        const double possible = clamp(wanted, -effort, effort);
        const double reached = clamp(possible, last - step, last + step);
        status |= possible != wanted ? (unsigned)STIFFGEN_STATUS_SATURATED : 0u;
        status |= reached != possible ? (unsigned)STIFFGEN_STATUS_RATE_LIMITED : 0u;
        /* A torque within the limits moves within them; a limit lowered at run time comes before the rate. */
        output->torque[i] = clamp(reached, -effort, effort);
        state->torque_step[i] = step;
    }
    return status;
}

/* ---- energy --------------------------------------------------------------------------------------------------- */

/*
 * Account of the interval since the last sample, from the torques of that sample; sets output's totals and powers.
 * shift: motion of the reference that the spring and the damper have felt. middle: 1/2 e^T K e with the error e of now
 * and the stiffness K of then. Returns what flows into the tank before the stiffness varies.
 */
static double account(const config_t *c, const state_t *state, const double *q, const double *shift, double *middle,
                      output_t *output)
{
    const output_t *const last = &state->last;
    const int spring = last->mode == STIFFGEN_MODE_RETURN || last->mode == STIFFGEN_MODE_ACTIVE;
    double motion[N], change[N], error[N], product[N];
    double antisymmetric = 0.0, limiting = 0.0, sampling = 0.0;
    for (int i = 0; i < N; ++i) {
        motion[i] = q[i] - last->position[i];
        change[i] = shift[i] - motion[i];
        error[i] = last->error[i] + change[i];
        limiting -= (last->torque[i] - last->elastic_torque[i] - last->damping_torque[i] - last->limit_torque[i]) *
                    change[i];
    }
    *middle = 0.0;
    if (spring) {
        *middle = half_form(last->stiffness, error);
        sampling = half_form(last->stiffness, change);
        if (c->stiffness_formula == STIFFGEN_STIFFNESS_FORMULA_CONVENTIONAL) {
            for (int i = 0; i < N; ++i) {
                product[i] = 0.0;
                for (int j = 0; j < N; ++j) {
                    product[i] += (last->stiffness[i * N + j] - last->stiffness[j * N + i]) / 2.0 * last->error[j];
                }
            }
            antisymmetric = -dot(product, change);
        }
    }
    const double dissipated = dot(last->damping_torque, change);
    const double limit_work = dot(last->limit_torque, motion);
    sampling += limit_work + output->limit_energy - last->limit_energy;
    output->port_total += limit_work - dot(last->torque, change) + dot(last->limit_torque, change);
    output->sampling_total += sampling;
    output->antisymmetric_total += antisymmetric;
    output->limiting_total += limiting;
    output->dissipated_total += dissipated;
    const double elapsed = c->sample_time * (1 + last->missed);
    output->dissipated_power = dissipated / elapsed;
    output->antisymmetric_power = antisymmetric / elapsed;
    /* What was dissipated pays debts in full; only a share of the rest is kept for later. */
    const double net = dissipated - sampling - antisymmetric - limiting;
    const double debt = last->tank_deficit;
    return net > debt ? debt + c->tank_refill * (net - debt) : net;
}

/* Tank after an income (negative: a drain); what it cannot pay is deficit, which is paid back first. */
static void fill_tank(const config_t *c, double level, output_t *output)
{
    output->tank_energy = clamp(level, c->tank_minimum, c->tank_maximum);
    output->tank_deficit = level < c->tank_minimum ? c->tank_minimum - level : 0.0;
}

/*
 * Move the applied stiffness towards the target: by the rate limit's share, then by the share that the tank can pay.
 * One factor for all entries keeps symmetry, and keeps a positive semidefinite stiffness so.
 */
static unsigned vary_stiffness(const config_t *c, const state_t *state, double income, double middle, double elapsed,
                               output_t *output)
{
    const double *const K = state->last.stiffness;
    double *const change = output->stiffness; /* first the difference, then the sum */
    unsigned status = 0;
    double norm = 0.0, size = 0.0, share = 1.0;
    for (int i = 0; i < NN; ++i) {
        change[i] = output->stiffness_target[i] - K[i];
        norm += change[i] * change[i];
        size += K[i] * K[i];
    }
    norm = sqrt(norm);
    size = sqrt(size);
    if (norm > c->stiffness_rate_limit * elapsed) {
        share = c->stiffness_rate_limit * elapsed / norm;
        status |= STIFFGEN_STATUS_STIFFNESS_RATE;
    }
    double level = state->last.tank_energy - state->last.tank_deficit + income;
    if (c->tank == STIFFGEN_TANK_ON) {
        const double cost = share * half_form(change, output->error);
        /* Less what rounding makes of the energies that are subtracted below, so that it cannot overdraw. */
        const double rounding = 1e-14 * (size + norm) * dot(output->error, output->error);
        const double free_energy = level - c->tank_minimum - rounding;
        const double budget = free_energy > 0.0 ? (1.0 - 1e-9) * free_energy : 0.0;
        if (cost > budget) {
            share *= budget / cost;
            status |= STIFFGEN_STATUS_TANK_LIMITED;
        }
    }
    for (int i = 0; i < NN; ++i) {
        output->stiffness[i] = share == 1.0 ? output->stiffness_target[i] : K[i] + share * change[i];
    }
    output->stiffness_step = share;
    output->elastic_energy = half_form(output->stiffness, output->error);
    const double variation = share > 0.0 ? output->elastic_energy - middle : 0.0;
    output->variation_total += variation;
    output->variation_power = variation / elapsed;
    if (c->tank == STIFFGEN_TANK_ON) {
        fill_tank(c, level - variation, output);
    }
    return status;
}

/* ---- step ------------------------------------------------------------------------------------------------------ */

/* Where the spring pulls: from the anchor to q0 along a cubic blend, with its velocity. */
static void blend_reference(const config_t *c, const state_t *state, const input_t *input, output_t *output)
{
    const double s = output->blend;
    const double weight = s * s * (3.0 - 2.0 * s);
    const double rate = s < 1.0 ? 6.0 * s * (1.0 - s) / c->return_time : 0.0;
    for (int i = 0; i < N; ++i) {
        const double way = input->q0[i] - state->anchor[i];
        output->reference[i] = s < 1.0 ? state->anchor[i] + weight * way : input->q0[i];
        output->reference_velocity[i] = weight * input->dq0[i] + rate * way;
        output->error[i] = output->reference[i] - input->q[i];
    }
}

/*
 * Velocity for the damping of the fallback. A robot that really is too fast must be braked: a velocity beyond its limit
 * counts as the limit, up to ten times. Further off, it is no measurement: the last believed one fades.
 */
static void fallback_velocity(const config_t *c, const state_t *state, const double *dq, double *velocity)
{
    const double fade = exp(-c->sample_time / c->velocity_decay_time);
    int plausible = dq != NULL;
    for (int i = 0; plausible && i < N; ++i) {
        plausible = fabs(dq[i]) <= 10.0 * c->velocity_limit[i];
    }
    for (int i = 0; i < N; ++i) {
        velocity[i] = plausible ? clamp(dq[i], -c->velocity_limit[i], c->velocity_limit[i])
                                : fade * state->last.velocity[i];
    }
}

static unsigned fall_back(const config_t *c, state_t *state, const input_t *input, int q_good, output_t *output)
{
    const double zero[N] = {0.0};
    const int spring = state->last.mode == STIFFGEN_MODE_RETURN || state->last.mode == STIFFGEN_MODE_ACTIVE;
    unsigned status = STIFFGEN_STATUS_FALLBACK;
    double middle = state->last.elastic_energy;
    output->dissipated_power = output->variation_power = output->antisymmetric_power = 0.0;
    if (q_good) {
        status |= avoid_limits(c, input->q, output);
        if (state->known) {
            const double income = account(c, state, input->q, zero, &middle, output);
            if (c->tank == STIFFGEN_TANK_ON) {
                fill_tank(c, state->last.tank_energy - state->last.tank_deficit + income, output);
            }
        } else {
            output->engaged_total += output->limit_energy;
        }
        memcpy(output->position, input->q, sizeof output->position);
    } else {
        /* Without a position there is no depth in the zone, and no account until one is known again. */
        memset(output->limit_torque, 0, sizeof output->limit_torque);
        output->released_total += output->limit_energy;
        output->limit_energy = 0.0;
        output->unaccounted += output->unaccounted < UINT32_MAX ? 1u : 0u;
    }
    state->known = q_good;
    output->released_total += spring ? middle : 0.0;
    output->mode = STIFFGEN_MODE_FALLBACK;
    output->elastic_energy = 0.0;
    output->blend = 0.0;
    output->stiffness_step = 0.0;
    for (int i = 0; i < N; ++i) {
        output->reference[i] = output->position[i];
        output->reference_velocity[i] = output->error[i] = output->elastic_torque[i] = 0.0;
    }
    fallback_velocity(c, state, input != NULL ? input->dq : NULL, output->velocity);
    multiply(output->damping, output->velocity, output->damping_torque);
    for (int i = 0; i < N; ++i) {
        output->damping_torque[i] = 0.0 - output->damping_torque[i];
    }
    return status | command(c, state, output);
}

static unsigned control(const config_t *c, state_t *state, const input_t *input, const double *J, unsigned status,
                        output_t *output)
{
    const output_t *const last = &state->last;
    const int fresh = last->mode == STIFFGEN_MODE_START || last->mode == STIFFGEN_MODE_FALLBACK;
    const double elapsed = c->sample_time * (1 + last->missed);
    double shift[N], middle = 0.0, income = 0.0;
    if (fresh) {
        memcpy(state->anchor, input->q, sizeof state->anchor);
        output->blend = c->return_time > 0.0 ? 0.0 : 1.0;
    } else if (last->blend < 1.0) {
        const double next = c->return_time > 0.0 ? last->blend + elapsed / c->return_time : 1.0;
        output->blend = next < 1.0 ? next : 1.0;
    }
    output->mode = output->blend < 1.0 ? STIFFGEN_MODE_RETURN : STIFFGEN_MODE_ACTIVE;
    status |= output->blend < 1.0 ? (unsigned)STIFFGEN_STATUS_RETURNING : 0u;
    blend_reference(c, state, input, output);
    status |= avoid_limits(c, input->q, output);
    output->dissipated_power = output->variation_power = output->antisymmetric_power = 0.0;
    for (int i = 0; i < N; ++i) {
        shift[i] = fresh ? 0.0 : output->reference[i] - last->reference[i];
    }
    if (state->known) {
        income = account(c, state, input->q, shift, &middle, output);
    } else {
        output->engaged_total += output->limit_energy;
    }
    if (fresh) {
        /* The spring starts at its target: at the anchor its error, its torque and its energy are zero. */
        memcpy(output->stiffness, output->stiffness_target, sizeof output->stiffness);
        output->stiffness_step = 1.0;
        output->elastic_energy = half_form(output->stiffness, output->error);
        output->engaged_total += output->elastic_energy;
        if (c->tank == STIFFGEN_TANK_ON) {
            fill_tank(c, last->tank_energy - last->tank_deficit + income, output);
        }
    } else {
        status |= vary_stiffness(c, state, income, middle, elapsed, output);
    }
    status |= design_damping(c, state, J, output);
    double slip[N];
    for (int i = 0; i < N; ++i) {
        output->position[i] = input->q[i];
        output->velocity[i] = input->dq[i];
        slip[i] = output->reference_velocity[i] - input->dq[i];
    }
    multiply(output->stiffness, output->error, output->elastic_torque);
    multiply(output->damping, slip, output->damping_torque);
    state->known = 1;
    return status | command(c, state, output);
}

static unsigned sample(const config_t *c, state_t *state, const input_t *input, output_t *output)
{
    const unsigned position = check_position(c, input->q);
    unsigned status = position | check_velocity(c, input->dq) | check_position(c, input->q0) |
                      check_velocity(c, input->dq0) | check_task(c, input);
    output->missed = 0;
    if (status == 0) {
        double J[6 * N];
        if (state->last.mode == STIFFGEN_MODE_START || state->last.mode == STIFFGEN_MODE_FALLBACK) {
            state->wrench_count = 0; /* what the filter knows is old */
        }
        filter_wrench(c, state, input->wrench, output->wrench);
        ROBOT(mass_matrix)(input->q, output->mass_matrix);
        kernels_jacobian(c, input->q, J);
        const unsigned flags = target_stiffness(c, state, input, J, output);
        if (all_finite(NN, output->mass_matrix) && all_finite(NN, output->stiffness_target)) {
            return control(c, state, input, J, flags, output);
        }
        status = STIFFGEN_STATUS_NON_FINITE;
        *output = state->last;
        output->missed = 0;
    }
    return status | fall_back(c, state, input, position == 0, output);
}

static unsigned no_sample(const config_t *c, state_t *state, output_t *output)
{
    unsigned status = STIFFGEN_STATUS_MISSED;
    output->missed = state->last.missed < INT32_MAX ? state->last.missed + 1 : INT32_MAX;
    if (output->missed < c->missed_limit && state->last.mode != STIFFGEN_MODE_FALLBACK) {
        /* The torque is held, as between two samples: the account of the longer interval stays exact. */
        return status | (state->last.status & (unsigned)(STIFFGEN_STATUS_RETURNING | STIFFGEN_STATUS_JOINT_LIMIT));
    }
    status |= output->missed >= c->missed_limit ? (unsigned)STIFFGEN_STATUS_WATCHDOG : 0u;
    return status | fall_back(c, state, NULL, 0, output);
}

/* Torque towards zero by the last valid rate limit: all that can be done without a configuration. */
static void refuse(state_t *state, output_t *output)
{
    *output = state->last;
    output->released_total += output->elastic_energy + output->limit_energy;
    for (int i = 0; i < N; ++i) {
        const double last = state->last.torque[i];
        output->torque[i] = last - clamp(last, -state->torque_step[i], state->torque_step[i]);
        output->elastic_torque[i] = output->damping_torque[i] = output->limit_torque[i] = 0.0;
        output->error[i] = 0.0;
    }
    output->limit_energy = output->elastic_energy = output->blend = 0.0;
    output->unaccounted += output->unaccounted < UINT32_MAX ? 1u : 0u;
    output->mode = STIFFGEN_MODE_FALLBACK;
    output->status = STIFFGEN_STATUS_CONFIG | STIFFGEN_STATUS_FALLBACK;
    state->known = 0;
    state->last = *output;
}

static int step(const config_t *config, state_t *state, const input_t *input, output_t *output)
{
    if (output == NULL) {
        return STIFFGEN_E_NULL;
    }
    const int missing = config == NULL || state == NULL || input == NULL;
    if (state == NULL || state->ready != READY) {
        memset(output, 0, sizeof *output);
        output->status = STIFFGEN_STATUS_CONFIG | STIFFGEN_STATUS_FALLBACK;
        output->mode = STIFFGEN_MODE_FALLBACK;
        return missing ? STIFFGEN_E_NULL : STIFFGEN_E_NOT_INITIALISED;
    }
    const int error = missing ? STIFFGEN_E_NULL : validate(config);
    if (error != STIFFGEN_OK) {
        refuse(state, output);
        return error;
    }
    *output = state->last;
    unsigned status = input->sample_valid == 1 ? sample(config, state, input, output) : no_sample(config, state, output);
    if (config->tank == STIFFGEN_TANK_ON && output->tank_deficit > 0.0) {
        status |= STIFFGEN_STATUS_TANK_DEFICIT;
    }
    output->status = (uint32_t)status;
    state->last = *output;
    return STIFFGEN_OK;
}
