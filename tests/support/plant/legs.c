/* SPDX-License-Identifier: MIT */
/*
 * Follow alone, to a pose that is held: what its q0 did on the way. Compiled for one robot: -DROBOT=NAME
 * -DUPPER=NAME_IN_CAPITALS with NAME_follow.h included.
 */
#include <math.h>
#include <string.h>

#define JOIN_NAMES(a, b) a##b
#define JOIN(a, b) JOIN_NAMES(a, b)
#define ROBOT_(name) JOIN(ROBOT, _##name)
#define UPPER_(name) JOIN(UPPER, _##name)

enum { N = UPPER_(DOF), CALM = 300 };

typedef struct {
    double beyond;          /* [rad] or [m] most beyond a limit less its distance; negative: within */
    double speed;           /* [1] most over the velocity limit */
    double distance, angle; /* [m], [rad] of the tip from the pose at the end */
    int samples, status;    /* until q0 rests for CALM samples; last status */
} leg_t;

static ROBOT_(follow_state) state;

int legs_begin(double sample_time, const double *q)
{
    ROBOT_(follow_config) config;
    ROBOT_(follow_default_config)(&config);
    config.sample_time = sample_time;
    return ROBOT_(follow_init)(&config, &state, q);
}

/* Go to a pose, until q0 rests or for so many samples. q: the last q0. */
void legs_go(const double *pose, const double *posture, int samples, double *q, leg_t *leg)
{
    const ROBOT_(follow_config) *const c = &state.config;
    ROBOT_(follow_input) input;
    ROBOT_(follow_output) output;
    memcpy(input.pose, pose, sizeof input.pose);
    memcpy(input.posture, posture, sizeof input.posture);
    memset(leg, 0, sizeof *leg);
    leg->beyond = -HUGE_VAL;
    for (int calm = 0; leg->samples < samples && calm < CALM; ++leg->samples) {
        double last[N];
        memcpy(last, state.q, sizeof last);
        ROBOT_(follow_step)(&state, &input, &output);
        calm = output.status & UPPER_(FOLLOW_MOVING) ? 0 : calm + 1;
        for (int i = 0; i < N; ++i) {
            leg->beyond = fmax(leg->beyond, output.q0[i] - c->upper_limit[i] + c->limit_distance[i]);
            leg->beyond = fmax(leg->beyond, c->lower_limit[i] + c->limit_distance[i] - output.q0[i]);
            leg->speed = fmax(leg->speed, fabs(output.q0[i] - last[i]) / (c->sample_time * c->velocity_limit[i]));
        }
    }
    memcpy(q, output.q0, sizeof output.q0);
    leg->distance = output.error[0];
    leg->angle = output.error[1];
    leg->status = (int)output.status;
}
