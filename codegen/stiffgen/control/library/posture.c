/*
 * Poses, and postures of a pose: while the equilibrium is commanded by its pose, the posture goes to the one nearest to
 * the wanted posture that has its tips at that pose. The springs of tips and posture are then at rest at the same q.
 */
#include "impedance.h"

static const double WAY_SHARE = 0.01; /* of the way to a goal, whose springs are looked at */
static const double NO_ROTATION = 1e-9; /* [rad] up to which a rotation is linear: its square is below rounding */
static const double RADIAN_LENGTH = 0.25; /* [m] that weigh as much as one radian in a posture's distance from a pose */
static const double FLAT_SHARE = 1e-9; /* added to X^T X of a posture, over the largest square of a row of X */
static const double SELF_MOTION_NEAR = 0.1; /* [m] or [rad] from a pose at which self-motion begins */
static const double LONGEST_STEP = 0.5; /* [rad] or [m] of a search */
static const double NEAR_TIME = 0.1; /* [s] of travel that one step of self-motion looks ahead */
static const double OTHER_POSTURE = 0.3; /* [rad] or [m] from the arm from which on a posture is another one */
static const double NEARER = 0.8; /* of a distance: a posture that is so much nearer is gone to directly */
/* Sine of a rotation up to which, near half a turn, it has lost the digits of the axis; sine too small to divide by. */
static const double HALF_TURN_SINE = 1e-6, NO_SINE = 1e-150;

/* Return the index of the largest of three numbers. */
static int find_largest(double a, double b, double c)
{
    if (a > b) {
        return a > c ? 0 : 2;
    }
    return b > c ? 1 : 2;
}

/* Compute the twist (hybrid axes) from one pose to another: the origin's motion and the rotation vector. */
void pose_difference(const double *from, const double *to, double *twist)
{
    double D[9], *const w = twist + 3; /* D: the rotation between them, R_to R_from^T */
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            D[3 * i + j] = dot(3, to + 4 * i, from + 4 * j);
        }
        twist[i] = to[4 * i + 3] - from[4 * i + 3];
    }
    const double cosine = (D[0] + D[4] + D[8] - 1.0) / 2.0;
    w[0] = (D[7] - D[5]) / 2.0; /* w: the axis times the sine */
    w[1] = (D[2] - D[6]) / 2.0;
    w[2] = (D[3] - D[1]) / 2.0;
    double sine = norm(3, w);
    const double angle = atan2(sine, cosine);
    if (sine <= HALF_TURN_SINE && cosine <= 0.0) {
        /* near half a turn the axis is the longest column of D + I */
        const int k = find_largest(D[0], D[4], D[8]);
        for (int i = 0; i < 3; ++i) {
            w[i] = D[3 * i + k] + (i == k ? 1.0 : 0.0);
        }
        sine = norm(3, w);
    }
    for (int i = 0; i < 3; ++i) {
        w[i] *= sine > NO_SINE ? angle / sine : 1.0;
    }
}

/* Return the largest distance [m] or angle [rad] of the tips' twists. */
double largest_part(const double *twists)
{
    double most = 0.0;
    for (int k = 0; k < TIP_ROWS; k += 3) {
        most = larger(most, norm(3, twists + k));
    }
    return most;
}

/* Compute the twists of all tips from their poses to others. Return the largest distance [m] or angle [rad]. */
double compare_poses(const double *from, const double *to, double *twists)
{
    for (int t = 0; t < TIPS; ++t) {
        pose_difference(from + 16 * t, to + 16 * t, twists + 6 * t);
    }
    return largest_part(twists);
}

/*
 * Move a pose by a twist (hybrid axes): its rotation becomes (I + a W + b W^2) R (Rodrigues), and is made orthonormal
 * again by a Newton step. moved may not be pose.
 */
void move_pose(const double *pose, const double *twist, double *moved)
{
    const double *const w = twist + 3, W[9] = {0.0, -w[2], w[1], w[2], 0.0, -w[0], -w[1], w[0], 0.0};
    const double angle = norm(3, w), a = angle > NO_ROTATION ? sin(angle) / angle : 1.0;
    const double b = angle > NO_ROTATION ? (1.0 - cos(angle)) / (angle * angle) : 0.5;
    double D[9], R[9];
    multiply3(W, 3, 0, W, 3, D);
    for (int k = 0; k < 9; ++k) {
        D[k] = (k % 4 == 0 ? 1.0 : 0.0) + a * W[k] + b * D[k];
    }
    multiply3(D, 3, 0, pose, 4, R);
    multiply3(R, 3, 1, R, 3, D); /* R^T R */
    for (int k = 0; k < 9; ++k) {
        D[k] = (k % 4 == 0 ? 1.5 : 0.0) - 0.5 * D[k];
    }
    memcpy(moved, pose, 16 * sizeof(double));
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) { /* R (3 I - R^T R) / 2; the second factor is symmetric */
            moved[4 * i + j] = dot(3, R + 3 * i, D + 3 * j);
        }
        moved[4 * i + 3] += twist[i];
    }
}

/*
 * Combine a damped least-squares step towards the pose's error with the part of `near` that leaves the tips where they
 * are: `near` less X G^-1 X^T near, G = X^T X (regularised). The rows of X are those of the joints, 0 where a joint is
 * held, which has its step already. Return whether it succeeded.
 */
static int combine_steps(const double *X, const double *error, const double *near, double damping, const int *held,
                         double *step)
{
    double G[TIP_ROWS * TIP_ROWS] = {0.0}, pull[TIP_ROWS] = {0.0}, self[TIP_ROWS] = {0.0};
    memcpy(pull, error, sizeof pull);
    for (int i = 0; i < N; ++i) {
        add_scaled(TIP_ROWS, near[i], X + i * TIP_ROWS, self);
    }
    multiply_transposed(N, TIP_ROWS, X, G);
    if (!solve_damped(TIP_ROWS, G, FLAT_SHARE + damping, pull) || !solve_damped(TIP_ROWS, G, FLAT_SHARE, self)) {
        return 0;
    }
    add_scaled(TIP_ROWS, -1.0, self, pull);
    for (int i = 0; i < N; ++i) {
        step[i] = held[i] ? step[i] : near[i] + dot(TIP_ROWS, X + i * TIP_ROWS, pull);
    }
    return 1;
}

/*
 * Hold the free joint whose step leads farthest beyond its limit zones, at their edge, and take out of X and error what
 * it does to the tips. Return whether there is one.
 */
static int hold_joint(const memory_t *m, const double *q, int *held, double *X, double *error, double *step)
{
    double farthest = 0.0, step_to_edge = 0.0;
    int found = NO_JOINT;
    for (int i = 0; i < N; ++i) {
        const double next = q[i] + step[i], edge = clamp(next, m->avoidance[4 * i], m->avoidance[4 * i + 1]);
        if (!held[i] && fabs(next - edge) > farthest) {
            farthest = fabs(next - edge);
            step_to_edge = edge - q[i];
            found = i;
        }
    }
    if (found == NO_JOINT) {
        return 0;
    }
    held[found] = 1;
    step[found] = step_to_edge;
    add_scaled(TIP_ROWS, -step_to_edge, X + found * TIP_ROWS, error);
    memset(X + found * TIP_ROWS, 0, TIP_ROWS * sizeof(double));
    return 1;
}

/*
 * Compute X = J^T, one row per joint, and weight it and the error, the tips' twists to their goal: RADIAN_LENGTH counts
 * as much as one radian, and the longest row of X has length 1. Return the damping of the step.
 */
static double weigh_error(const memory_t *m, const double *q, double *X, double *error)
{
    double J[TIP_ROWS * N] = {0.0}, weights[TIP_ROWS] = {0.0}, longest = DBL_MIN;
    stiffgen_jacobians(q, m, J);
    transpose(TIP_ROWS, N, J, X);
    for (int r = 0; r < TIP_ROWS; ++r) {
        weights[r] = r % 6 < 3 ? 1.0 / RADIAN_LENGTH : 1.0;
    }
    scale_columns(N, TIP_ROWS, weights, X);
    for (int i = 0; i < N; ++i) {
        longest = larger(longest, dot(TIP_ROWS, X + i * TIP_ROWS, X + i * TIP_ROWS));
    }
    const double inverse = 1.0 / sqrt(longest);
    for (int k = 0; k < N * TIP_ROWS; ++k) {
        X[k] *= inverse;
    }
    for (int r = 0; r < TIP_ROWS; ++r) {
        error[r] *= inverse * weights[r];
    }
    const double squares = dot(TIP_ROWS, error, error);
    return squares + STEP_SHARE * sqrt(squares);
}

/*
 * Find the step from the posture q towards the one nearest to `wanted` that has its tips at their goal and lies outside
 * the limit zones. error: twists from the tips' poses in q to the goal. Return their largest part, in [m] or [rad].
 *
 * The step is damped by e . e and by its root. The first keeps it short far from the goal and at singular postures. The
 * second bounds what the neglected second derivative of e does to the share of the step that is gone in one call.
 */
double find_posture_step(const config_t *c, const memory_t *m, const double *q, const double *error,
                         const double *wanted, double *step)
{
    double X[N * TIP_ROWS] = {0.0}, rest[TIP_ROWS] = {0.0}, near[N] = {0.0}, excess = 0.0;
    int held[N] = {0};
    memcpy(rest, error, sizeof rest);
    const double distance = largest_part(error), damping = weigh_error(m, q, X, rest);
    memset(step, 0, N * sizeof(double));
    for (int i = 0; i < N; ++i) {
        near[i] = clamp(wanted[i], m->avoidance[4 * i], m->avoidance[4 * i + 1]) - q[i];
        excess = larger(excess, fabs(near[i]) / (c->reference_velocity_limit[i] * NEAR_TIME));
    }
    for (int i = 0; i < N; ++i) { /* self-motion: as far as NEAR_TIME allows, and only near the pose */
        near[i] *= larger(1.0 - distance / SELF_MOTION_NEAR, 0.0) / larger(excess, 1.0);
    }
    int good = 1, again = 1;
    for (int round = 1; round <= N && again; ++round) { /* each round holds one more joint at its limit zone */
        good = combine_steps(X, rest, near, damping, held, step);
        again = good && round < N && hold_joint(m, q, held, X, rest, step);
    }
    if (!good) {
        memset(step, 0, N * sizeof(double));
    }
    return distance;
}

/*
 * Out of reach, where the wanted posture is nearer to the commanded pose than the posture is: replace its step by the
 * way there. A stretched arm is a saddle of the pose's error, from which damped steps lead back slowly, or to the other
 * side. The wanted posture q0 is what the command states: no other configuration is searched. distance: that of the
 * posture from the commanded pose, goal.
 */
void step_to_wanted(const memory_t *m, const double *q0, double distance, const double *goal, double *step)
{
    double wanted[N], poses[16 * TIPS], twists[TIP_ROWS] = {0.0};
    for (int i = 0; i < N; ++i) {
        wanted[i] = clamp(q0[i], m->avoidance[4 * i], m->avoidance[4 * i + 1]);
    }
    stiffgen_poses(wanted, m, poses);
    if (compare_poses(poses, goal, twists) < NEARER * distance) {
        for (int i = 0; i < N; ++i) {
            step[i] = wanted[i] - m->posture[i];
        }
    }
}

/* Return whether the arm is so far from its posture that this is another one. */
int is_far_behind(const memory_t *m)
{
    double most = 0.0;
    for (int i = 0; i < N; ++i) {
        most = larger(most, fabs(m->posture[i] - m->q[i]));
    }
    return most > OTHER_POSTURE;
}

/* Return whether a step leads the posture away from an arm that is far behind it. */
int leads_away(const memory_t *m, const double *step)
{
    double away = 0.0;
    for (int i = 0; i < N; ++i) {
        away += step[i] * (m->posture[i] - m->q[i]);
    }
    return away > 0.0 && is_far_behind(m);
}

/*
 * Return how deep a joint is in its limit zone: 0 at the zone's edge, `zone` at the limit, below 0 outside. side: above
 * 0 for the zone of the upper limit, else that of the lower one.
 */
double find_depth(const memory_t *m, int i, double side)
{
    return side > 0.0 ? m->q[i] - m->avoidance[4 * i + 1] : m->avoidance[4 * i] - m->q[i];
}

/* Return the torque [N m] by which springs at an equilibrium push joints outwards that are at a limit or beyond. */
static double find_push(const memory_t *m, const double *equilibrium, double zone)
{
    double wrench[6 * TIPS], torque[N], stiffness[NN], push = 0.0; /* of these the torque alone is used */
    stiffgen_spring(m->q, m, equilibrium, m->translation_stiffness, m->rotation_stiffness, find_spring_limits(m),
                    wrench, torque, stiffness);
    for (int i = 0; i < N; ++i) { /* the torque's sign is the side to which it pushes */
        push += torque[i] != 0.0 && find_depth(m, i, torque[i]) >= zone ? fabs(torque[i]) : 0.0;
    }
    return push;
}

/* Return whether the springs push a joint out of its limits, and the way to the goal does not lower this push. */
int is_pushed_out(const step_t *s)
{
    const memory_t *const m = s->m;
    double nearer[16 * TIPS], way[TIP_ROWS] = {0.0};
    const double push = find_push(m, m->equilibrium, s->c->limit_zone);
    add_scaled(TIP_ROWS, WAY_SHARE, s->away, way);
    for (int t = 0; t < TIPS; ++t) {
        move_pose(m->equilibrium + 16 * t, way + 6 * t, nearer + 16 * t);
    }
    return push > 0.0 && !(find_push(m, nearer, s->c->limit_zone) < push);
}

/*
 * Choose where a trial of the search starts: first at `start`, then ever farther from it. avoidance has the edges of
 * the limit zones.
 */
static void start_trial(const memory_t *m, const double *start, int number, double *q)
{
    const double share = 0.4 + 0.6 * number / (double)SEARCHED; /* of the way from `start` to an even spread */
    for (int i = 0; i < N; ++i) {
        const double *const a = m->avoidance + 4 * i;
        const double low = larger(a[0], start[i] - HALF_TURN), high = smaller(a[1], start[i] + HALF_TURN);
        const double far = start[i] + share * (low + spread_joint(number, i) * (high - low) - start[i]);
        q[i] = clamp(number == 0 ? start[i] : far, a[0], a[1]);
    }
}

/* Follow steps from q towards a posture of the goal. Return whether one is found: at most SEARCH_STEPS steps. */
static int try_posture(const config_t *c, const memory_t *m, const double *goal, double *q)
{
    double step[N], here[16 * TIPS], error[TIP_ROWS] = {0.0};
    int found = 0;
    for (int k = 0; k < SEARCH_STEPS && !found; ++k) {
        stiffgen_poses(q, m, here);
        (void)compare_poses(here, goal, error);
        /* wanted is q itself: no self-motion. Found is well within REACHED, and improved by one step more. */
        found = find_posture_step(c, m, q, error, q, step) <= 0.1 * REACHED;
        const double size = norm(N, step);
        add_scaled(N, size > LONGEST_STEP ? LONGEST_STEP / size : 1.0, step, q);
    }
    return found;
}

/* Accept poses and tools (NULL: none) of a search; the tools go to the memory. Return whether all are accepted. */
static int accept_search(const double *poses, const double *tool, double *goal, memory_t *m)
{
    int good = 1;
    for (int t = 0; good && t < TIPS; ++t) {
        refusal_t r = {ID(REFUSAL_NONE), ID(ARGUMENT_NONE), NO_JOINT, 0.0, 0.0};
        double accepted[16];
        good = accept_pose(poses + 16 * t, FARTHEST, ID(ARGUMENT_EQUILIBRIUM), t, goal + 16 * t, &r) &&
               (tool == NULL || accept_pose(tool + 16 * t, FARTHEST, ID(ARGUMENT_TOOL_POSE), t, accepted, &r));
        if (good && tool != NULL) {
            memcpy(m->tool_pose + 16 * t, accepted, sizeof accepted);
        }
    }
    return good;
}

/*
 * Search for a posture of poses outside the limit zones, from `start` on. No step calls this: the caller decides
 * whether the arm goes there. tool: poses of tools, or NULL. Return OK, or why there is no result; then posture is
 * `start`.
 */
int search_posture(const config_t *c, const double *poses, const double *tool, const double *start, double *posture)
{
    memory_t m; /* a fresh one: of it tools, loops and limit zones are used */
    double goal[16 * TIPS], q[N];
    const int error = validate(c);
    memset(&m, 0, sizeof m);
    place_no_tools(m.tool_pose);
    stiffgen_home(&m);
    memcpy(q, start, sizeof q); /* `start` and `posture` may be one array */
    memcpy(posture, q, sizeof q);
    if (error != ID(OK)) {
        return error;
    }
    if (!doubles_within(q, N, -FARTHEST, FARTHEST) || !accept_search(poses, tool, goal, &m)) {
        return ID(E_POSE);
    }
    for (int i = 0; i < N; ++i) {
        m.avoidance[4 * i] = c->lower_limit[i] + c->limit_zone;
        m.avoidance[4 * i + 1] = c->upper_limit[i] - c->limit_zone;
    }
    for (int number = 0; number < SEARCHED; ++number) {
        start_trial(&m, start, number, q);
        if (try_posture(c, &m, goal, q) && stiffgen_reaches(q, &m)) {
            memcpy(posture, q, sizeof q);
            return ID(OK);
        }
    }
    return ID(E_NO_POSTURE);
}
