/* Governor: the equilibrium follows the wanted one, within bounds on its velocity, force and work. */
#include "impedance.h"

/* Return the largest norm of the vectors of x, each of the given length, over the governor's share of its limit. */
static double relative_size(int count, int length, const double *x, const double *limits)
{
    double most = 0.0;
    for (int k = 0; k < count; k += length) {
        most = fmax(most, norm(length, x + k) / (GOVERNOR * limits[k / length]));
    }
    return most;
}

/*
 * Update the velocity towards a goal: the goal's own velocity, if it is within the limits, and a velocity that reduces
 * the remaining distance to zero and from which the ramp can stop. away: from here to the goal, including `moved`, the
 * goal's motion since the last step.
 */
static void approach_goal(const config_t *c, int count, int length, const double *away, const double *moved,
                          const double *limits, double *velocity)
{
    const double T = c->sample_time, slope = T / c->ramp_time;
    double target[MAX_ROWS] = {0.0}, change[MAX_ROWS] = {0.0}, rest[MAX_ROWS] = {0.0};
    const int follow = relative_size(count, length, moved, limits) <= T;
    for (int i = 0; i < count; ++i) {
        rest[i] = away[i] - (follow ? moved[i] : 0.0);
    }
    const double way = relative_size(count, length, rest, limits);
    const double stop = sqrt(0.25 * slope * slope + 2.0 * slope * (way / T)) - 0.5 * slope;
    const double speed = fmin(fmin(way / T, 1.0), stop);
    for (int i = 0; i < count; ++i) {
        target[i] = (follow ? moved[i] / T : 0.0) + (way > 0.0 ? rest[i] * (speed / way) : 0.0);
    }
    const double size = relative_size(count, length, target, limits);
    for (int i = 0; i < count; ++i) {
        change[i] = target[i] / fmax(size, 1.0) - velocity[i];
    }
    const double jump = relative_size(count, length, change, limits);
    add_scaled(count, jump > slope ? slope / jump : 1.0, change, velocity);
}

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
    double D[9], *const w = twist + 3;
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            D[3 * i + j] = dot(3, to + 4 * i, from + 4 * j);
        }
        twist[i] = to[4 * i + 3] - from[4 * i + 3];
    }
    const double cosine = (D[0] + D[4] + D[8] - 1.0) / 2.0;
    w[0] = (D[7] - D[5]) / 2.0;
    w[1] = (D[2] - D[6]) / 2.0;
    w[2] = (D[3] - D[1]) / 2.0;
    double sine = norm(3, w);
    const double angle = atan2(sine, cosine);
    if (sine <= 1e-6 && cosine <= 0.0) {
        /* near half a turn the axis is the longest column of D + I */
        const int k = find_largest(D[0], D[4], D[8]);
        for (int i = 0; i < 3; ++i) {
            w[i] = D[3 * i + k] + (i == k ? 1.0 : 0.0);
        }
        sine = norm(3, w);
    }
    for (int i = 0; i < 3; ++i) {
        w[i] *= sine > 1e-150 ? angle / sine : 1.0;
    }
}

/* Move a pose by a twist (hybrid axes), and make its rotation orthonormal again. */
void move_pose(const double *pose, const double *twist, double *moved)
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
        for (int j = 0; j < 3; ++j) { /* R (3 I - R^T R) / 2; the second factor is symmetric */
            moved[4 * i + j] = dot(3, R + 3 * i, D + 3 * j);
        }
        moved[4 * i + 3] += twist[i];
    }
}

/* Predict posture and equilibrium after a share of this step's motion. */
static void predict_equilibrium(const step_t *s, double share, int by_posture, double *posture, double *equilibrium)
{
    const memory_t *const m = s->m;
    const double T = share * s->c->sample_time;
    memcpy(posture, m->posture, N * sizeof(double));
    add_scaled(N, T, m->posture_velocity, posture);
    if (by_posture) {
        robot_poses(posture, m->tool_pose, equilibrium);
        return;
    }
    for (int t = 0; t < TIPS; ++t) {
        double twist[6] = {0.0};
        add_scaled(6, T, m->equilibrium_velocity + 6 * t, twist);
        move_pose(m->equilibrium + 16 * t, twist, equilibrium + 16 * t);
    }
}

/* Update the velocities of posture and equilibrium. Return whether either is still away from its goal. */
static int update_velocities(step_t *s, int by_posture)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const double tip_limits[2] = {c->tip_velocity_limit, c->tip_rotation_limit};
    double away[MAX_ROWS], moved[MAX_ROWS], here[16 * TIPS];
    int moving = 0;
    const int joining = s->input->command == ID(COMMAND_POSITION) && !by_posture;
    for (int i = 0; i < N; ++i) {
        away[i] = s->commanded && !joining ? s->input->q0[i] - m->posture[i] : 0.0;
        moved[i] = s->commanded && !joining ? s->input->q0[i] - m->wanted_posture[i] : 0.0;
        moving |= away[i] != 0.0;
    }
    approach_goal(c, N, 1, away, moved, c->reference_velocity_limit, m->posture_velocity);
    if (by_posture) {
        return moving;
    }
    /* after commands by pose the equilibrium first joins the posture's pose */
    robot_poses(m->posture, m->tool_pose, here);
    m->joined = joining && s->commanded;
    for (int t = 0; t < TIPS; ++t) {
        const double *const goal = (joining ? here : s->goal) + 16 * t;
        memset(away, 0, sizeof away);
        memset(moved, 0, sizeof moved);
        if (s->commanded) {
            pose_difference(m->equilibrium + 16 * t, goal, away);
        }
        if (s->commanded && !joining) {
            pose_difference(m->wanted_equilibrium + 16 * t, goal, moved);
        }
        const int arrived = relative_size(6, 3, away, tip_limits) <= 1e-12;
        m->joined &= arrived;
        moving |= !arrived;
        approach_goal(c, 6, 3, away, moved, tip_limits, m->equilibrium_velocity + 6 * t);
    }
    return moving;
}

/*
 * Return the time [s] that the governor's velocity limits need for the largest of the motions between postures and
 * poses.
 */
double travel_between(const config_t *c, const double *posture, const double *goal, const double *equilibrium,
                      const double *goal_pose)
{
    const double tip_limits[2] = {c->tip_velocity_limit, c->tip_rotation_limit};
    double away[N], twist[6];
    for (int i = 0; i < N; ++i) {
        away[i] = goal[i] - posture[i];
    }
    double travel = relative_size(N, 1, away, c->reference_velocity_limit);
    for (int t = 0; goal_pose != NULL && t < TIPS; ++t) {
        pose_difference(equilibrium + 16 * t, goal_pose + 16 * t, twist);
        travel = fmax(travel, relative_size(6, 3, twist, tip_limits));
    }
    return travel;
}

/*
 * Let a moving command bring in reference work, by the distance that it moves: an engagement limit per TRAVEL_TIME of
 * the equilibrium's travel. What the command moved is paid out no faster than the equilibrium can travel, and no
 * further than the equilibrium is away from the command.
 */
static void pay_for_travel(step_t *s)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const double *const q0 = s->input->q0, *pose = s->goal;
    const int by_pose = s->input->command == ID(COMMAND_EQUILIBRIUM);
    double there[16 * TIPS];
    if (!s->commanded) {
        return;
    }
    if (by_pose && !m->by_pose) {
        robot_poses(m->wanted_posture, m->tool_pose, m->wanted_equilibrium);
    }
    if (!by_pose && (m->by_pose || !m->joined)) {
        robot_poses(q0, m->tool_pose, there);
        pose = there;
    }
    const double *const moved_pose = by_pose || m->by_pose ? pose : NULL;
    const double *const away_pose = by_pose || !m->joined ? pose : NULL;
    const double moved = travel_between(c, m->wanted_posture, q0, m->wanted_equilibrium, moved_pose);
    const double away = travel_between(c, m->posture, q0, m->equilibrium, away_pose);
    m->travel = fmin(m->travel + moved, away);
    const double paid = fmin(m->travel, c->sample_time);
    const double work = m->engagement + s->engagement_limit * (paid / TRAVEL_TIME);
    m->travel -= paid;
    m->engagement = fmax(m->engagement, fmin(work, s->engagement_limit));
    m->by_pose = by_pose;
}

/*
 * Find the share of this step's motion that keeps the tip's velocity, the stored energy (where a load holds it above
 * the limit, it must not rise) and the work left to the engagement. Results: posture and equilibrium there, and the
 * rise of the stored energy.
 */
static double find_share(step_t *s, int by_posture, double *posture, double *equilibrium, double *rise)
{
    const config_t *const c = s->c;
    memory_t *const m = s->m;
    const double tip_limits[2] = {c->tip_velocity_limit, c->tip_rotation_limit};
    const double left = fmax(m->engagement - worst_feed_work(m, m->feed, m->call_gap), 0.0);
    const double allowed = fmin(fmax(s->energy_limit - m->elastic_energy, 0.0), left);
    double share = 1.0;
    int reached = 0;
    for (int attempt = 0; attempt < 5 && !reached; ++attempt) {
        double speed = 0.0, twist[6];
        predict_equilibrium(s, share, by_posture, posture, equilibrium);
        for (int t = 0; by_posture && t < TIPS; ++t) {
            pose_difference(m->equilibrium + 16 * t, equilibrium + 16 * t, twist);
            speed = fmax(speed, relative_size(6, 3, twist, tip_limits) / c->sample_time);
        }
        *rise = m->scale * compute_spring_energy(m, m->q, equilibrium, posture) - m->elastic_energy;
        reached = speed <= 1.0 && *rise <= allowed;
        if (speed > 1.0) {
            share *= (1.0 - 1e-9) / speed;
        } else if (!reached) {
            share *= attempt < 3 && allowed > 0.0 ? 0.9 * allowed / *rise : 0.0;
            s->status |= ID(STATUS_GOVERNOR);
        }
    }
    return reached ? share : 0.0;
}

/* Move the equilibrium towards the wanted one, within the governor's bounds. */
void move_equilibrium(step_t *s)
{
    memory_t *const m = s->m;
    double posture[N], equilibrium[16 * TIPS], rise = 0.0;
    pay_for_travel(s);
    const int by_posture = m->joined && (!s->commanded || s->input->command == ID(COMMAND_POSITION));
    const int moving = update_velocities(s, by_posture);
    const double share = find_share(s, by_posture, posture, equilibrium, &rise);
    s->status |= moving ? (uint32_t)ID(STATUS_MOVING) : 0u;
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
        book_reference(s, rise);
    }
    if (s->commanded) {
        memcpy(m->wanted_posture, s->input->q0, sizeof posture);
        if (s->input->command == ID(COMMAND_EQUILIBRIUM)) {
            memcpy(m->wanted_equilibrium, s->goal, sizeof equilibrium);
            m->joined = 0;
        }
    }
}

/* Take stiffness, tool and goal from an accepted command; nothing is stored in the springs. */
static void adopt_command(step_t *s)
{
    memory_t *const m = s->m;
    if (m->law == ID(LAW_POTENTIAL)) {
        memcpy(m->translation_stiffness, s->translation, 9 * TIPS * sizeof(double));
        memcpy(m->rotation_stiffness, s->rotation, 9 * TIPS * sizeof(double));
    } else {
        memset(m->translation_stiffness, 0, 9 * TIPS * sizeof(double));
        memset(m->rotation_stiffness, 0, 9 * TIPS * sizeof(double));
    }
    memcpy(m->wanted_posture, s->input->q0, sizeof m->wanted_posture);
    memcpy(m->wanted_equilibrium, s->goal, sizeof m->wanted_equilibrium);
    if (robot_tool(s->input) != NULL) {
        memcpy(m->tool_pose, robot_tool(s->input), sizeof m->tool_pose);
    }
    m->by_pose = s->input->command == ID(COMMAND_EQUILIBRIUM);
    m->commanded = 1;
}

/* Start an engagement. Its energy first makes up for what the tank lacks. */
static void start_engagement(step_t *s)
{
    memory_t *const m = s->m;
    m->engaged = 1;
    m->scale = 1.0;
    measure_inertia(s, m->q);
    if (available_energy(m) < 0.0) {
        /* more was put out than there was: the account ends here, and begins anew */
        m->unaccounted += 1u;
        m->tank -= available_energy(m);
    }
    const double lack = clamp(s->tank_initial - m->tank, 0.0, s->engagement_limit);
    m->tank += lack;
    m->engagement = s->engagement_limit - lack;
}

/* Settle the springs at the arm, where they store nothing: equilibrium, stiffness, tool and law are free to change. */
void settle_springs(step_t *s)
{
    memory_t *const m = s->m;
    m->law = s->c->law;
    m->spring = s->c->spring;
    for (int t = 0; t < TIPS; ++t) {
        m->spring_limits[t] = s->c->spring_force_limit;
        m->spring_limits[TIPS + t] = s->c->spring_moment_limit;
    }
    memcpy(m->posture, m->q, sizeof m->posture);
    memset(m->posture_velocity, 0, sizeof m->posture_velocity);
    memset(m->equilibrium_velocity, 0, sizeof m->equilibrium_velocity);
    memcpy(m->posture_stiffness, s->c->posture_stiffness, sizeof m->posture_stiffness);
    m->scale = m->elastic_energy = m->travel = 0.0;
    m->joined = 1;
    if (s->commanded) {
        adopt_command(s);
    }
    robot_poses(m->q, m->tool_pose, m->equilibrium);
    if (s->commanded && m->fault == ID(FAULT_NONE)) {
        start_engagement(s);
    }
}
