/* SPDX-License-Identifier: MIT */
#include "episode.h"

#include <math.h>
#include <string.h>

enum { MOST_DELAY = 8, MOST_WINDOW = 16 };

static const double FULL_TURN = 6.28318530717958648;

typedef struct {
    double past[MOST_WINDOW][N], held_q[N], held_dq[N]; /* past: the last measured positions, newest first */
    double off[N]; /* [rad] most that a position in single precision was off by */
    int seen;
    uint32_t counter, drawn;
} sensors_t;

/* Return whether something happens that has this chance. */
static int happens(sensors_t *sensors, double chance)
{
    sensors->drawn = sensors->drawn * 1664525u + 1013904223u;
    return (sensors->drawn >> 8) / 16777216.0 < chance;
}

static double largest(const double *x, const double *over)
{
    double most = 0.0;
    for (int i = 0; i < N; ++i) {
        most = fmax(most, fabs(x[i]) / (over != NULL ? over[i] : 1.0));
    }
    return most;
}

static void to_single(double *values, int count)
{
    for (int i = 0; i < count; ++i) {
        values[i] = (float)values[i];
    }
}

/* Poses of tools: positions, and turns about the x axis. */
static void place_tools(const double *tool, double *poses)
{
    memset(poses, 0, 16 * TIPS * sizeof *poses);
    for (int t = 0; t < TIPS; ++t) {
        double *const pose = poses + 16 * t, turn = tool[4 * t + 3];
        pose[0] = pose[15] = 1.0;
        pose[5] = pose[10] = cos(turn);
        pose[9] = sin(turn);
        pose[6] = -pose[9];
        for (int i = 0; i < 3; ++i) {
            pose[4 * i + 3] = tool[4 * t + i];
        }
    }
}

static void measure(const episode_t *e, const segment_t *s, const motion_t *motion, sensors_t *sensors, double t,
                    sample_t *sample)
{
    for (int i = 0; i < N; ++i) {
        const double exact = motion->q[i] + s->q_offset[i];
        double q = e->quantum > 0.0 ? e->quantum * nearbyint(exact / e->quantum) : exact;
        if (s->q_stuck && (s->q_mask >> i & 1)) {
            q = s->q_stuck == STUCK_ZERO ? 0.0 : sensors->held_q[i];
        }
        double dq = motion->v[i];
        if (e->differences) {
            const int window = sensors->seen < e->differences ? sensors->seen : e->differences;
            dq = window > 0 ? (q - sensors->past[window - 1][i]) / (window * e->sample_time) : 0.0;
        }
        dq += s->dq_offset[i];
        if (s->dq_stuck && (s->dq_mask >> i & 1)) {
            dq = s->dq_stuck == STUCK_ZERO ? 0.0 : sensors->held_dq[i];
        }
        for (int k = MOST_WINDOW - 1; k > 0; --k) {
            sensors->past[k][i] = sensors->past[k - 1][i];
        }
        sensors->past[0][i] = sensors->held_q[i] = q;
        sensors->held_dq[i] = dq;
        const double turn = e->wrapped >> i & 1 ? FULL_TURN : HUGE_VAL;
        sample->q[i] = remainder(q, turn);
        if (e->single_positions) {
            const double whole = sample->q[i];
            sample->q[i] = (float)whole;
            sensors->off[i] = fmax(sensors->off[i], fabs(sample->q[i] - whole));
        }
        sample->dq[i] = dq;
        sample->wanted[i] = s->wanted[i] + t * s->wanted_rate[i] + (sensors->counter & 1u ? s->jitter : 0.0);
        sample->wanted[i] = remainder(sample->wanted[i], turn);
        sample->wanted_rate[i] = s->wanted_rate[i];
    }
    sensors->seen += sensors->seen < MOST_WINDOW;
    sensors->counter += s->frozen_counter ? 0u : 1u;
    sample->counter = sensors->counter + e->first_counter;
    sample->valid = !s->missed;
    sample->shaped = s->shaped;
    sample->joint = s->joint;
    memcpy(sample->acceleration, s->acceleration, sizeof sample->acceleration);
    memcpy(sample->wrench_command, s->wrench_command, sizeof sample->wrench_command);
    memcpy(sample->translation, s->translation, sizeof sample->translation);
    memcpy(sample->rotation, s->rotation, sizeof sample->rotation);
    memcpy(sample->torque_offset, s->torque_offset, sizeof sample->torque_offset);
    place_tools(s->tool, sample->tool);
    if (e->single) {
        to_single(sample->dq, N);
        to_single(sample->wanted, N);
        to_single(sample->acceleration, N);
        to_single(sample->wrench_command, 6 * TWISTS);
        to_single(sample->translation, 9 * SPRINGS);
        to_single(sample->rotation, 9 * SPRINGS);
        to_single(sample->torque_offset, N);
    }
}

/* Time [s] that the reference, at its share of the velocity limits, needs for the path of the command. */
static double travel(const episode_t *e, const sample_t *sample, const sample_t *last)
{
    double most = 0.0;
    for (int i = 0; i < N; ++i) {
        most = fmax(most, fabs(sample->wanted[i] - last->wanted[i]) / (0.72 * e->velocity_limit[i]));
    }
    return most;
}

/* Velocity limits that speeds are compared with: those in force, where the law has any. */
static const double *limits_in_force(const episode_t *e, const command_t *command)
{
    return e->limited && command->velocity_limit[0] > 0.0 ? command->velocity_limit : e->velocity_limit;
}

/* speed: [rad/s] velocity limits, which the rates of the segment are relative to those of the episode of */
static void drive(const episode_t *e, const segment_t *s, const double *speed, const double *torque, motion_t *motion,
                  double T)
{
    for (int i = 0; i < N; ++i) {
        const double before = motion->v[i], most = s->driven_by[i] * T, share = speed[i] / e->velocity_limit[i];
        double rate = s->driven_to[i] * share;
        if (s->driven == DRIVEN_ALONG) {
            rate = torque[i] != 0.0 ? copysign(rate, torque[i]) : 0.0;
        } else if (s->driven == DRIVEN_POSTURE) {
            /* as fast as it can still stop there, if the steps are small */
            const double way = s->driven_to[i] - motion->q[i];
            rate = fmin(fmin(sqrt(s->driven_by[i] * fabs(way)), 0.2 * fabs(way) / T), s->driven_at[i] * share);
            rate = copysign(rate, way);
        }
        const double change = rate - before;
        motion->v[i] += fabs(change) > most ? copysign(most, change) : change;
        motion->q[i] += (before + motion->v[i]) / 2.0 * T;
    }
}

/*
 * Work [J] of the motors' own loops: exact for kp and for the velocity of a driven arm, which is linear in time. Of a free
 * arm the same rule is exact up to the third power of the time.
 */
static double gains_work(const forces_t *forces, const motion_t *from, const motion_t *to, double T)
{
    double work = 0.0;
    for (int i = 0; i < N; ++i) {
        const double a = from->q[i] - forces->q_des[i], b = to->q[i] - forces->q_des[i], u = from->v[i], v = to->v[i];
        work += 0.5 * forces->kp[i] * (a * a - b * b) - forces->kd[i] * T * (u * u + u * v + v * v) / 3.0;
    }
    return work;
}

/*
 * Most [J] that the account of motors' own loops is off by in an interval, if it reads motions that are off by twice
 * `off` [rad]: kp x^2 / 2 and kd x^2 / T.
 */
static double misread_gains(const forces_t *forces, const motion_t *from, const motion_t *to, const double *off, double T)
{
    double most = 0.0;
    for (int i = 0; i < N; ++i) {
        const double x = fmax(fabs(to->q[i] - forces->q_des[i]), fabs(to->q[i] - from->q[i])) + off[i];
        most += 4.0 * off[i] * x * (0.5 * forces->kp[i] + forces->kd[i] / T);
    }
    return most;
}

static void account(const episode_t *e, const command_t *command, const double *last, summary_t *summary)
{
    for (int i = 0; i < N; ++i) {
        const double torque = command->torque[i];
        if (!isfinite(torque)) {
            summary->finite = 0;
            continue;
        }
        summary->torque = fmax(summary->torque, fabs(torque));
        summary->effort = fmax(summary->effort, fabs(torque) / e->effort[i]);
        summary->torque_step = fmax(summary->torque_step, fabs(torque - last[i]) / (e->rate[i] * e->sample_time));
    }
}

int episode_run(const episode_t *e, int samples, int segments, const segment_t *segment, const void *const *configs,
                void *state, void *output, int every_output, row_t *rows, summary_t *summary)
{
    motion_t motion = {{0}, {0}, 0.0, 0.0}, before;
    forces_t forces;
    sensors_t sensors;
    sample_t sample, last, delivered;
    command_t command;
    double pipe[MOST_DELAY + 1][N] = {{0}}, offsets[MOST_DELAY + 1][N] = {{0}};
    uint32_t draw = 1u;
    const double zeros[N] = {0};
    double commanded[N] = {0}, last_reference[N] = {0}, last_tip[3] = {0}, least[N] = {0}, most[N] = {0};
    int at = 0, was_faulted = 0, clamped = 0, initialised = 0, known = 0, skipped = 0, calls = 0;
    int have_delivered = 0, delay = e->delay;
    double swing[N] = {0}; /* [N m] sum of the changes of torque */
    memset(&forces, 0, sizeof forces);
    memset(&sensors, 0, sizeof sensors);
    memset(&delivered, 0, sizeof delivered);
    memset(&command, 0, sizeof command);
    memset(summary, 0, sizeof *summary);
    summary->finite = 1;
    summary->excess_supplied = -HUGE_VAL;
    memcpy(motion.q, e->q, sizeof motion.q);
    memcpy(motion.v, e->v, sizeof motion.v);
    const double kinetic = plant_kinetic_energy(&e->plant, &motion);
    summary->kinetic = kinetic;
    for (int k = 0; k < samples; ++k) {
        while (at + 1 < segments && segment[at + 1].start <= k) {
            ++at;
        }
        const segment_t *const s = &segment[at];
        const double t = (k - s->start) * e->sample_time;
        if (s->clamp && !clamped) {
            double poses[16 * TIPS];
            robot_poses(motion.q, NULL, poses);
            memcpy(forces.clamp_pose, poses, sizeof forces.clamp_pose);
        }
        clamped = forces.clamped = s->clamp;
        memcpy(forces.load, s->load, sizeof forces.load);
        memcpy(forces.push, s->push, sizeof forces.push);
        memcpy(forces.hand_target, s->hand_target, sizeof forces.hand_target);
        forces.hand_stiffness = s->hand_stiffness;
        forces.hand_damping = s->hand_damping;
        double wrench[6];
        plant_tip_wrench(&e->plant, &motion, &forces, wrench);
        summary->force_most = fmax(summary->force_most, sqrt(wrench[0] * wrench[0] + wrench[1] * wrench[1] +
                                                             wrench[2] * wrench[2]));
        summary->moment_most = fmax(summary->moment_most, sqrt(wrench[3] * wrench[3] + wrench[4] * wrench[4] +
                                                               wrench[5] * wrench[5]));
        memcpy(summary->wrench, wrench, sizeof wrench);
        measure(e, s, &motion, &sensors, t, &sample);
        for (int i = 0; i < 6; ++i) {
            sample.wrench[i] = s->measure_wrench ? wrench[i] + s->wrench_bias[i] : 0.0;
        }
        sample.reset = s->reset && k == s->start;
        const int restarted = s->restart && k == s->start && initialised;
        if (!initialised || restarted) {
            const int code = law_init(configs[s->config], state, s->restart == RESTART_IN_FORCE ? commanded : NULL, sample.tool);
            if (code != 0) {
                return code;
            }
            initialised = 1;
        }
        if (restarted) { /* the motors are off before it, or the last torque has been in force for the delay */
            const double *const acting = s->restart == RESTART_IN_FORCE ? commanded : zeros;
            for (int d = 0; d <= MOST_DELAY; ++d) {
                memcpy(pipe[d], acting, sizeof pipe[d]);
            }
            memcpy(forces.torque, acting, sizeof forces.torque);
            memcpy(commanded, acting, sizeof commanded);
            memset(offsets, 0, sizeof offsets);
            memset(&command, 0, sizeof command);
            summary->port = 0.0;
            skipped = known = was_faulted = calls = have_delivered = 0;
            delay = e->delay + s->late_torque;
            ++summary->restarts;
        }
        const int in_force = e->limited && command.call_gap > 0 ? command.call_gap - 1 : s->skip;
        const int most_skipped = restarted ? 0 : in_force; /* init is followed by a call */
        const int late = e->late > 0.0 && happens(&sensors, e->late);
        skipped = (late || skipped < s->skip) && skipped < most_skipped ? skipped + 1 : 0;
        summary->lates += late && skipped > 0;
        if (skipped == 0 && sample.valid) {
            summary->travel += initialised > 1 ? travel(e, &sample, &last) : 0.0;
            initialised = 2;
            last = sample;
        }
        if (skipped == 0) {
            if (sample.valid && have_delivered && e->stale > 0.0 && happens(&sensors, e->stale)) {
                sample.counter = delivered.counter;
                memcpy(sample.q, delivered.q, sizeof sample.q);
                memcpy(sample.dq, delivered.dq, sizeof sample.dq);
                ++summary->stales;
            }
            have_delivered |= sample.valid;
            delivered = sample.valid ? sample : delivered;
            law_step(state, &sample, output, &command);
            if (initialised == 2 && calls++ == 0) { /* the first call that has a sample, not the first in time */
                summary->first_energy = command.energy;
            }
            account(e, &command, commanded, summary);
            memcpy(commanded, command.torque, sizeof commanded);
            summary->codes += command.code != 0;
            summary->status_or |= command.status;
            summary->status_last = command.status;
            summary->faults += command.faulted && !was_faulted;
            summary->faulted += command.faulted != 0;
            if (command.faulted && summary->faults == 1 && !was_faulted) {
                summary->reason = command.reason;
                summary->fault_at = k;
            }
            /* a return whose call ends in another fault brings in nothing */
            summary->resets += was_faulted && !command.faulted;
            was_faulted = command.faulted != 0;
            double H[16 * TIPS], moved[N], tip = 0.0;
            robot_poses(command.reference, NULL, H);
            for (int i = 0; i < N; ++i) {
                moved[i] = command.reference[i] - last_reference[i];
                moved[i] /= e->sample_time;
            }
            for (int i = 0; i < 3; ++i) {
                tip += (H[4 * i + 3] - last_tip[i]) * (H[4 * i + 3] - last_tip[i]);
                last_tip[i] = H[4 * i + 3];
            }
            if (known && !command.faulted) {
                summary->reference_speed = fmax(summary->reference_speed, largest(moved, e->velocity_limit));
                summary->tip_reference_speed = fmax(summary->tip_reference_speed, sqrt(tip) / e->sample_time);
            }
            known = !command.faulted; /* in a fault the equilibrium follows the arm */
            memcpy(last_reference, command.reference, sizeof last_reference);
            if (every_output) {
                output = (char *)output + law_output_size();
            }
        }
        for (int d = MOST_DELAY; d > 0; --d) {
            memcpy(pipe[d], pipe[d - 1], sizeof pipe[d]);
            memcpy(offsets[d], offsets[d - 1], sizeof offsets[d]);
        }
        memcpy(pipe[0], commanded, sizeof pipe[0]);
        memcpy(offsets[0], command.offset, sizeof offsets[0]);
        for (int i = 0; i < N; ++i) {
            swing[i] += fabs(pipe[delay][i] - forces.torque[i]);
        }
        memcpy(forces.torque, pipe[delay], sizeof forces.torque);
        memcpy(forces.kp, command.kp, sizeof forces.kp);
        memcpy(forces.kd, command.kd, sizeof forces.kd);
        for (int i = 0; i < N; ++i) { /* a motor knows what its encoder shows */
            const double turn = e->wrapped >> i & 1 ? FULL_TURN : HUGE_VAL;
            forces.q_des[i] = motion.q[i] + remainder(command.q_des[i] - motion.q[i], turn);
        }
        before = motion;
        draw = draw * 1664525u + 1013904223u;
        const double T = e->sample_time * (1.0 - e->early * (draw >> 8) / 16777216.0);
        const double *const speed = limits_in_force(e, &command);
        if (s->driven) {
            drive(e, s, speed, forces.torque, &motion, T);
        } else {
            plant_advance(&e->plant, &motion, &forces, T);
        }
        if (e->fastest > 0.0 && fmax(largest(before.v, speed), largest(motion.v, speed)) > e->fastest) {
            motion = before;
            break;
        }
        summary->port += gains_work(&forces, &before, &motion, T);
        for (int i = 0; i < N; ++i) {
            summary->port += (forces.torque[i] - offsets[delay][i]) * (motion.q[i] - before.q[i]);
            summary->excursion = fmax(summary->excursion, fabs(motion.q[i] - sample.wanted[i]));
            summary->wander = fmax(summary->wander, fabs(motion.q[i] - e->q[i]));
        }
        const double paid = e->engagement * (summary->resets + (e->streamed ? (k + 1) * e->sample_time
                                                                          : fmin(summary->travel, (k + 1) * e->sample_time)));
        summary->excess_travel = k == 0 ? summary->port - paid : fmax(summary->excess_travel, summary->port - paid);
        summary->port_most = fmax(summary->port_most, summary->port);
        summary->allowance += e->single_positions ? misread_gains(&forces, &before, &motion, sensors.off, T) : 0.0;
        double allowance = summary->allowance;
        for (int i = 0; i < N; ++i) {
            allowance += sensors.off[i] * (swing[i] + fabs(forces.torque[i]));
        }
        const double beyond = calls > 0 ? summary->port - allowance - command.supplied : -HUGE_VAL;
        summary->excess_supplied = fmax(summary->excess_supplied, beyond);
        summary->excess = k == 0 ? summary->port - summary->resets * e->engagement
                                 : fmax(summary->excess, summary->port - summary->resets * e->engagement);
        summary->speed = fmax(summary->speed, largest(motion.v, e->velocity_limit));
        double J[6 * N], tip_velocity = 0.0;
        robot_jacobian(motion.q, J);
        for (int r = 0; r < 3; ++r) {
            double rate = 0.0;
            for (int i = 0; i < N; ++i) {
                rate += J[r * N + i] * motion.v[i];
            }
            tip_velocity += rate * rate;
        }
        summary->tip_speed = fmax(summary->tip_speed, sqrt(tip_velocity));
        if (k >= samples - samples / 10) {
            summary->final_speed = fmax(summary->final_speed, largest(motion.v, NULL));
            for (int i = 0; i < N; ++i) {
                least[i] = k == samples - samples / 10 ? motion.q[i] : fmin(least[i], motion.q[i]);
                most[i] = k == samples - samples / 10 ? motion.q[i] : fmax(most[i], motion.q[i]);
                summary->ripple = fmax(summary->ripple, most[i] - least[i]);
            }
        }
        if (rows != NULL) {
            row_t *const row = &rows[k];
            memcpy(row->q, motion.q, sizeof row->q);
            memcpy(row->v, motion.v, sizeof row->v);
            memcpy(row->acted, forces.torque, sizeof row->acted);
            memcpy(row->reference, command.reference, sizeof row->reference);
            memcpy(row->wrench, wrench, sizeof row->wrench);
            row->port = summary->port;
            row->energy = command.energy;
            row->tank = command.tank;
            row->deficit = command.deficit;
            row->scale = command.scale;
            row->kinetic = plant_kinetic_energy(&e->plant, &motion);
            row->status = command.status;
            row->faulted = command.faulted;
        }
        summary->finished = k + 1;
        double sum = 0.0;
        for (int i = 0; i < N; ++i) {
            sum += motion.q[i] + motion.v[i];
        }
        if (!isfinite(sum)) {
            break;
        }
    }
    summary->kinetic = plant_kinetic_energy(&e->plant, &motion);
    summary->energy_error = summary->kinetic - kinetic - motion.environment_work - motion.robot_work;
    double error = 0.0;
    for (int i = 0; i < N; ++i) {
        summary->allowance += sensors.off[i] * (swing[i] + fabs(forces.torque[i]));
        error = fmax(error, fabs(motion.q[i] - sample.wanted[i]));
    }
    summary->error = error;
    memcpy(summary->q, motion.q, sizeof summary->q);
    memcpy(summary->v, motion.v, sizeof summary->v);
    memcpy(summary->acted, forces.torque, sizeof summary->acted);
    memcpy(summary->reference, command.reference, sizeof summary->reference);
    return 0;
}
