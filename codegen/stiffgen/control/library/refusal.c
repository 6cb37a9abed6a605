/* Commands: what is accepted, and why what is not is refused. */
#include "impedance.h"

static const double POSE_TOLERANCE = 1e-3; /* of a commanded rotation, sum of |R^T R - I|: 5 digits */

/* Note why a command is refused; the first reason stays. Outputs are finite: NaN counts as 0. Return 0. */
int refuse_command(refusal_t *r, int code, int command, int entry, double seen, double limit)
{
    if (r->code == ID(REFUSAL_NONE)) {
        r->code = code;
        r->command = command;
        r->entry = entry;
        r->seen = isnan(seen) ? 0.0 : clamp(seen, -DBL_MAX, DBL_MAX);
        r->limit = limit;
    }
    return 0;
}

/* Check that numbers are no larger than a bound; NaN is. Return whether all are. */
static int check_numbers(int count, const double *x, double most, int code, int command, int entry, refusal_t *r)
{
    int good = 1;
    for (int i = 0; i < count; ++i) {
        good = good && (fabs(x[i]) <= most || refuse_command(r, code, command, entry + i, x[i], most)); /* returns 0 */
    }
    return good;
}

/*
 * Check that a stiffness is symmetric and positive semidefinite, up to single precision. symmetric: the mean of K and
 * its transpose. Return whether it is.
 */
static int check_definite(const double *K, const double *symmetric, int command, int entry, refusal_t *r)
{
    const double most = larger(COMMAND_TOLERANCE * largest_entry(9, K), DBL_MIN);
    double A[9], values[3] = {0.0}, vectors[9];
    for (int i = 0; i < 3; ++i) {
        for (int j = i + 1; j < 3; ++j) {
            const double apart = fabs(K[3 * i + j] - K[3 * j + i]);
            if (!(apart <= most)) {
                return refuse_command(r, ID(REFUSAL_ASYMMETRIC), command, entry + 3 * i + j, apart, most);
            }
        }
    }
    if (is_positive_semidefinite(3, symmetric, COMMAND_TOLERANCE)) {
        return 1;
    }
    memcpy(A, symmetric, sizeof A);
    (void)diagonalise_symmetric(3, A, values, vectors);
    return refuse_command(r, ID(REFUSAL_INDEFINITE), command, entry, values[0], -most);
}

/*
 * Copy a stiffness, made symmetric in every bit. command: translation_stiffness or rotation_stiffness. Return whether K
 * is one, up to single precision.
 */
int accept_stiffness(const double *K, double most, int command, int tip, double *accepted, refusal_t *r)
{
    take_symmetric_part(3, K, accepted);
    return check_numbers(9, K, DBL_MAX, ID(REFUSAL_NOT_FINITE), command, 9 * tip, r) &&
           check_numbers(9, K, most, ID(REFUSAL_STIFFNESS_LIMIT), command, 9 * tip, r) &&
           check_definite(K, accepted, command, 9 * tip, r);
}

/* Make a rotation that is almost one orthonormal, by two Newton steps R (3 I - R^T R) / 2. */
static void orthonormalise(double *pose)
{
    double C[9], R[9];
    for (int round = 0; round < 2; ++round) {
        multiply3(pose, 4, 1, pose, 4, C);
        for (int i = 0; i < 9; ++i) {
            C[i] = (i % 4 == 0 ? 1.5 : 0.0) - 0.5 * C[i];
        }
        multiply3(pose, 4, 0, C, 3, R);
        for (int i = 0; i < 9; ++i) {
            pose[i / 3 * 4 + i % 3] = R[i];
        }
    }
}

/*
 * Copy a pose. A rotation that is orthonormal up to POSE_TOLERANCE only is made so. command: equilibrium, tool_pose or
 * none; reach: the largest distance from the origin. Return whether the pose is one.
 */
int accept_pose(const double *pose, double reach, int command, int tip, double *accepted, refusal_t *r)
{
    double C[9], off = 0.0; /* off: sum of the deviations from a pose */
    const int first = 16 * tip;
    memcpy(accepted, pose, 16 * sizeof(double));
    if (!check_numbers(16, pose, DBL_MAX, ID(REFUSAL_NOT_FINITE), command, first, r)) {
        return 0;
    }
    for (int i = 0; i < 4; ++i) {
        const double wanted = i == 3 ? 1.0 : 0.0, apart = fabs(pose[12 + i] - wanted);
        if (apart > POSE_TOLERANCE) {
            return refuse_command(r, ID(REFUSAL_LAST_ROW), command, first + 12 + i, pose[12 + i], wanted);
        }
        off += apart;
    }
    const double det = pose[0] * (pose[5] * pose[10] - pose[6] * pose[9]) -
                       pose[1] * (pose[4] * pose[10] - pose[6] * pose[8]) +
                       pose[2] * (pose[4] * pose[9] - pose[5] * pose[8]);
    multiply3(pose, 4, 1, pose, 4, C);
    for (int i = 0; i < 9; ++i) {
        off += fabs(C[i] - (i % 4 == 0 ? 1.0 : 0.0));
    }
    if (!(off <= POSE_TOLERANCE)) {
        return refuse_command(r, ID(REFUSAL_ROTATION), command, first, off, POSE_TOLERANCE);
    }
    if (!(det > 0.0)) {
        return refuse_command(r, ID(REFUSAL_LEFT_HANDED), command, first, det, 1.0);
    }
    const double position[3] = {pose[3], pose[7], pose[11]};
    if (!(norm(3, position) <= reach)) {
        return refuse_command(r, ID(REFUSAL_REACH), command, first + 3, norm(3, position), reach);
    }
    if (off > ROUNDED) {
        orthonormalise(accepted);
    }
    return 1;
}

/* Accept a wrench that a tip is to exert: finite, and no larger than heaviest_wrench. Return whether it is accepted. */
int accept_wrench(const config_t *c, const double *wrench, int tip, refusal_t *r)
{
    for (int k = 0; k < 2; ++k) {
        const double size = norm(3, wrench + 3 * k), most = c->heaviest_wrench[k];
        if (!(size <= most * (1.0 + ROUNDED))) {
            const int code = size <= DBL_MAX ? ID(REFUSAL_WRENCH) : ID(REFUSAL_NOT_FINITE);
            return refuse_command(r, code, ID(ARGUMENT_WRENCH_COMMAND), 6 * tip + 3 * k, size, most);
        }
    }
    return 1;
}

/*
 * Accept q0; a continuous joint takes the turn nearest to the reference. Beyond a joint limit by up to
 * position_tolerance q0 is followed to the zone at this limit, to the point that is nearest to the reference: not
 * farther outwards than where the limit avoidance begins, and not inwards. Beyond it by no more than single precision
 * q0 is the limit. Return whether it is accepted.
 */
static int accept_positions(step_t *s)
{
    const config_t *const c = s->c;
    const double *const reference = s->m->engaged ? s->m->posture : s->m->q;
    const int q0 = ID(ARGUMENT_Q0);
    int good = check_numbers(N, s->input->q0, FARTHEST, ID(REFUSAL_NOT_FINITE), q0, 0, &s->refusal);
    for (int i = 0; good && i < N; ++i) {
        const double wanted = nearest_turn(s, i, s->input->q0[i], reference[i]);
        const double lower = c->lower_limit[i], upper = c->upper_limit[i];
        const double limit = clamp(wanted, lower, upper), beyond = fabs(wanted - limit);
        const double rounded = COMMAND_TOLERANCE * larger(1.0, fabs(limit));
        s->q0[i] = limit;
        /* the last command on the same turn, so that a turn between the two is no motion of the goal */
        s->m->wanted_posture[i] = nearest_turn(s, i, s->m->wanted_posture[i], limit);
        if (beyond > larger(c->position_tolerance, rounded)) {
            good = refuse_command(&s->refusal, ID(REFUSAL_POSITION), q0, i, wanted, limit);
        } else if (beyond > rounded) {
            s->q0[i] = wanted > upper ? clamp(reference[i], upper - c->limit_zone, upper)
                                      : clamp(reference[i], lower, lower + c->limit_zone);
            s->limited = s->limited == NO_JOINT ? i : s->limited;
        }
    }
    return good;
}

/* Accept the pose of a tip's tool; while the springs are in force it is the one that they have. */
static int accept_tool(const memory_t *m, const double *tool, int tip, refusal_t *r)
{
    const int first = 16 * tip;
    double accepted[16];
    if (!accept_pose(tool + first, FARTHEST, ID(ARGUMENT_TOOL_POSE), tip, accepted, r)) {
        return 0;
    }
    for (int k = first; k < first + 16; ++k) {
        if (m->engaged && !(fabs(tool[k] - m->tool_pose[k]) <= COMMAND_TOLERANCE)) {
            return refuse_command(r, ID(REFUSAL_ENGAGED), ID(ARGUMENT_TOOL_POSE), k, tool[k], m->tool_pose[k]);
        }
    }
    return 1;
}

/*
 * Accept a command that can be followed: positions within joint limits and in the reach of closed loops, poses within
 * reach, and stiffnesses within limits. Poses and stiffnesses are used as they are accepted, orthonormal and symmetric.
 * Return whether the command is accepted.
 */
int accept_command(step_t *s)
{
    const input_t *const in = s->input;
    refusal_t *const r = &s->refusal;
    const double *const tool = stiffgen_tool(in);
    const int by_pose = in->command == ID(COMMAND_EQUILIBRIUM);
    if (!by_pose && in->command != ID(COMMAND_POSITION)) {
        return refuse_command(r, ID(REFUSAL_COMMAND), ID(ARGUMENT_NONE), NO_JOINT, in->command, 0.0);
    }
    int good = accept_positions(s);
    for (int t = 0; good && t < TIPS; ++t) {
        const double *const Kt = in->translation_stiffness + 9 * t, *const Ko = in->rotation_stiffness + 9 * t;
        const int translation = ID(ARGUMENT_TRANSLATION_STIFFNESS), rotation = ID(ARGUMENT_ROTATION_STIFFNESS);
        good = tool == NULL || accept_tool(s->m, tool, t, r);
        const double reach = stiffgen_reach(t, tool) + REACH_MARGIN;
        good = good && (!by_pose || accept_pose(in->equilibrium + 16 * t, reach, ID(ARGUMENT_EQUILIBRIUM), t,
                                                s->goal + 16 * t, r));
        good = good &&
               accept_stiffness(Kt, s->c->translation_stiffness_limit, translation, t, s->translation + 9 * t, r) &&
               accept_stiffness(Ko, s->c->rotation_stiffness_limit, rotation, t, s->rotation + 9 * t, r);
    }
    good = good && (stiffgen_reaches(s->q0, s->m) ||
                    refuse_command(r, ID(REFUSAL_LOOPS), ID(ARGUMENT_Q0), NO_JOINT, 0.0, 0.0));
    s->limited = good ? s->limited : NO_JOINT;
    s->status |= s->limited != NO_JOINT ? (uint32_t)ID(STATUS_COMMAND_LIMITED) : 0u;
    return good;
}
