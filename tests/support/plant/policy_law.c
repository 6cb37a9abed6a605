/* SPDX-License-Identifier: MIT */
/*
 * The generated controller behind its policy port, with a hostile commander: what an episode commands is proposed late by
 * up to 2 s, in jitter, out of order, with time stamps that lie, with NaN and with jumps. policy_seed chooses the commander.
 */
#include <math.h>
#include <string.h>

static int hostile_step(const iiwa14_impedance_config *config, iiwa14_impedance_state *state, iiwa14_impedance_input *in,
                        iiwa14_impedance_output *out);
static int hostile_init(const iiwa14_impedance_config *config, iiwa14_impedance_state *state, const double *torque);

#define iiwa14_impedance_step hostile_step
#define iiwa14_impedance_init hostile_init
#include "law.c"
#undef iiwa14_impedance_step
#undef iiwa14_impedance_init

enum { KEPT = 256 };

unsigned int policy_seed = 1;
int policy_refused[9], policy_accepted; /* parts of all episodes, by reason */

static iiwa14_impedance_policy port;
static iiwa14_impedance_proposal kept[KEPT];
static uint64_t number;
static double period, latest, stale, lies, next_time;
static int started, written;

static double draw(void)
{
    number ^= number << 13;
    number ^= number >> 7;
    number ^= number << 17;
    return (double)(number >> 11) / 9007199254740992.0;
}

static int hostile_init(const iiwa14_impedance_config *config, iiwa14_impedance_state *state, const double *torque)
{
    number = 0x9E3779B97F4A7C15u ^ ((uint64_t)policy_seed << 17);
    for (int i = 0; i < 8; ++i) {
        draw();
    }
    period = 1.0 / (10.0 + 50.0 * draw());
    stale = draw() < 0.5 ? 0.0 : 2.0 * draw();
    lies = draw() < 0.3 ? 0.0 : 0.5 * draw() * draw();
    next_time = latest = 0.0;
    started = written = 0;
    return iiwa14_impedance_init(config, state, torque);
}

/* Spoil a proposal: a number that is none, a pose or stiffness that jumps, time stamps out of order or in the future. */
static void spoil(iiwa14_impedance_proposal *x, double now)
{
    static const double bad[4] = {NAN, INFINITY, -1e300, 1e5};
    double *const number_of[4] = {x->equilibrium, x->stiffness, x->wrench_command, x->time};
    static const int size[4] = {12, 36, 6, 4};
    const int kind = (int)(6.0 * draw()), part = (int)(4.0 * draw());
    if (kind == 0) {
        number_of[part][(int)(size[part] * draw())] = bad[(int)(4.0 * draw())];
    } else if (kind == 1) {
        for (int i = 0; i < 3; ++i) {
            x->equilibrium[4 * i + 3] += 2.0 * draw() - 1.0;
        }
    } else if (kind == 2) {
        const double scale = pow(10.0, 4.0 * draw() - 2.0);
        for (int i = 0; i < 36; ++i) {
            x->stiffness[i] *= scale;
        }
    } else if (kind == 3) { /* half a turn */
        for (int i = 0; i < 3; ++i) {
            x->equilibrium[4 * i] = -x->equilibrium[4 * i];
            x->equilibrium[4 * i + 1] = -x->equilibrium[4 * i + 1];
        }
    } else if (kind == 4) {
        x->time[part] = now + (draw() - 0.9) * 0.05;
    } else {
        x->valid[part] = 0;
    }
}

static void keep(const iiwa14_impedance_input *in, double now)
{
    iiwa14_impedance_proposal *const x = &kept[written++ % KEPT];
    memset(x, 0, sizeof *x);
    memcpy(x->equilibrium, in->equilibrium, sizeof x->equilibrium);
    memcpy(x->wrench_command, in->wrench_command, sizeof x->wrench_command);
    for (int i = 0; i < 9; ++i) {
        x->stiffness[i / 3 * 6 + i % 3] = in->translation_stiffness[i];
        x->stiffness[(i / 3 + 3) * 6 + i % 3 + 3] = in->rotation_stiffness[i];
    }
    for (int part = 0; part < 4; ++part) {
        x->valid[part] = 1;
        x->time[part] = now;
    }
}

static int hostile_step(const iiwa14_impedance_config *config, iiwa14_impedance_state *state, iiwa14_impedance_input *in,
                        iiwa14_impedance_output *out)
{
    const double now = in->counter * config->sample_time;
    if (!started) {
        started = iiwa14_impedance_policy_start(&port, in->equilibrium, now) == IIWA14_OK;
        port.smoothing = 0.09 * (policy_seed % 11);
    }
    if (now >= next_time) {
        keep(in, now);
        next_time = now + period * (0.2 + 1.6 * draw());
        const int back = (int)(stale * draw() * draw() / period);
        const int at = written - 1 - (back < written ? back : written - 1);
        iiwa14_impedance_proposal x = kept[(at > written - KEPT ? at : written - 1) % KEPT];
        if (draw() < lies) {
            spoil(&x, now);
        }
        for (int part = 0; draw() < 0.5 && part < 4; ++part) { /* old contents under a new stamp */
            x.time[part] = x.time[part] == x.time[part] ? fmax(x.time[part], now - 0.9 * draw()) : x.time[part];
        }
        if (draw() < 0.95 || written < 3) {
            iiwa14_impedance_policy_propose(config, &port, &x, now);
            for (int part = 0; part < 4; ++part) {
                policy_accepted += x.valid[part] && port.refused[part] == IIWA14_REFUSED_NONE;
                policy_refused[port.refused[part]] += 1;
            }
        }
    }
    iiwa14_impedance_policy_command(&port, now, in);
    return iiwa14_impedance_step(config, state, in, out);
}
