/* SPDX-License-Identifier: MIT */
/* Makers of commands within the loop: Settle, Press and Follow; and the surface that the tip touches. */
#include "arms.h"

#include <math.h>
#include <stddef.h>
#include <string.h>

/* Begin at the arm's positions. Return 0 or an error. */
int start_makers(const plant_t *p, const ROBOT_(impedance_config) *config, const double *q, makers_t *m)
{
    ROBOT_(follow_config) follow;
    ROBOT_(settle_config) settle;
    ROBOT_(press_config) press;
    memset(m, 0, sizeof *m);
    ROBOT_(follow_default_config)(&follow);
    follow.sample_time = p->sample_time;
    ROBOT_(settle_default_config)(&settle);
    memcpy(settle.settle_force, p->settle_force, sizeof settle.settle_force);
    ROBOT_(press_default_config)(&press);
    int code = ROBOT_(follow_init)(&follow, &m->follow, q);
    code = code == 0 ? ROBOT_(settle_init)(&settle, config, &m->settle) : code;
    return code == 0 ? ROBOT_(press_init)(&press, config, &m->press) : code;
}

/*
 * Take the axis of pressing: that of the row, or, once half of the force is felt, the mean of 20 ms of what is against the
 * measured force.
 */
static void choose_axis(const plant_t *p, makers_t *m, const double *row, const double *wrench, double *axis)
{
    const double force = sqrt(wrench[0] * wrench[0] + wrench[1] * wrench[1] + wrench[2] * wrench[2]);
    const double share = p->normal && force > 0.5 * row[3] ? p->sample_time / 0.02 : 0.0;
    double size = 0.0;
    if (!m->started || !p->normal) {
        memcpy(m->normal, row, sizeof m->normal);
    }
    for (int k = 0; k < 3; ++k) {
        m->normal[k] += share * (-wrench[k] / fmax(force, 1e-9) - m->normal[k]);
        size += m->normal[k] * m->normal[k];
    }
    for (int k = 0; k < 3; ++k) {
        axis[k] = m->normal[k] /= sqrt(size);
    }
    m->started = 1;
}

/* Make q0 and wrench_command from the commanded pose, what the sensor measures, and the controller's last output. */
void make_command(const plant_t *p, makers_t *m, const inputs_t *in, int k, const double *wrench,
                  const ROBOT_(impedance_output) *last, made_t *made, row_t *row)
{
    ROBOT_(follow_input) follow;
    ROBOT_(follow_output) path;
    ROBOT_(settle_input) rest;
    ROBOT_(settle_output) moved;
    ROBOT_(press_input) push;
    ROBOT_(press_output) pushed;
    memset(&follow, 0, sizeof follow);
    memset(&rest, 0, sizeof rest);
    memset(&push, 0, sizeof push);
    for (int i = 0; i < 3; ++i) {
        push.translation_stiffness[4 * i] = rest.translation_stiffness[4 * i] = in->translation[3 * k + i];
        push.rotation_stiffness[4 * i] = rest.rotation_stiffness[4 * i] = in->rotation[3 * k + i];
    }
    for (int i = 0; i < 6; ++i) {
        push.wrench[i] = rest.wrench[i] = p->wrench_gain * wrench[i] + in->wrench_noise[6 * k + i];
    }
    memcpy(rest.pose, in->pose + 16 * k, sizeof rest.pose);
    ROBOT_(settle_step)(&m->settle, &rest, last, &moved);
    choose_axis(p, m, in->press + 5 * k, push.wrench, push.axis);
    push.force = in->press[5 * k + 3];
    push.search = in->press[5 * k + 4] > 0.0;
    memcpy(push.pose, moved.pose, sizeof push.pose);
    ROBOT_(press_step)(&m->press, &push, last, &pushed);
    memcpy(follow.pose, pushed.pose, sizeof follow.pose);
    memcpy(follow.posture, in->goal + k * N, sizeof follow.posture);
    ROBOT_(follow_step)(&m->follow, &follow, &path);
    memcpy(made->q0, path.q0, sizeof made->q0);
    memcpy(made->wrench_command, pushed.wrench_command, sizeof made->wrench_command);
    memcpy(row->command, pushed.pose, sizeof row->command);
    row->detail[0] = pushed.error;
    row->detail[1] = pushed.stage;
}

/* Compute the force on a tip of the wall: a plane, cylinder or bowl, which may move along its normal. */
void touch_surface(const plant_t *p, const double *place, const double *velocity, double wall, double wall_speed,
                   double *force)
{
    const int curved = p->wall_radius != 0.0;
    double normal[3], away[3], depth = 0.0, speed = 0.0, along = 0.0, size = 0.0, slide[3], sliding = 0.0;
    for (int k = 0; k < 3; ++k) {
        away[k] = place[k] - p->wall_point[k];
        along += away[k] * p->wall_axis[k];
    }
    for (int k = 0; k < 3; ++k) {
        away[k] -= curved ? along * p->wall_axis[k] : 0.0;
        size += away[k] * away[k];
    }
    for (int k = 0; k < 3; ++k) {
        normal[k] = curved ? away[k] * (p->wall_radius > 0.0 ? 1.0 : -1.0) / fmax(sqrt(size), 1e-9) : p->wall_normal[k];
        depth -= normal[k] * away[k];
        speed += normal[k] * velocity[k];
    }
    depth += p->wall_radius + wall;
    if (!(p->wall_stiffness > 0.0 && depth > 0.0)) {
        return;
    }
    const double pressed = fmax(p->wall_stiffness * depth + p->wall_damping * (wall_speed - speed), 0.0);
    for (int k = 0; k < 3; ++k) {
        slide[k] = velocity[k] - speed * normal[k];
        sliding += slide[k] * slide[k];
    }
    const double rub = p->wall_friction * pressed / fmax(sqrt(sliding), 2e-3); /* [N s/m] */
    for (int k = 0; k < 3; ++k) {
        force[k] = pressed * normal[k] - rub * slide[k];
    }
}
