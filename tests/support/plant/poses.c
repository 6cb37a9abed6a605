/* SPDX-License-Identifier: MIT */
/*
 * Any robot's controller with commands by pose or position, and a rigid arm on the robot's own mass matrix and bias forces, without
 * gravity, friction and load. ROBOT is the robot's name, UPPER the prefix of its macros.
 */
#define JOIN_(a, b) a##b
#define JOIN(a, b) JOIN_(a, b)
#define NAMED(name) JOIN(ROBOT, name)
#define ID(name) JOIN(UPPER, name)
#define TEXT_(a) #a
#define TEXT(a) TEXT_(a)
#include TEXT(HEADER)

#include <math.h>
#include <string.h>

enum { COUNT = ID(_DOF) };

size_t poses_config_size(void)
{
    return sizeof(NAMED(_impedance_config));
}

void poses_default_config(void *config)
{
    NAMED(_impedance_default_config)(config);
}

/* Solve M x = b for a positive definite M (destroyed); x replaces b. */
static void solve(double *M, double *b)
{
    for (int k = 0; k < COUNT; ++k) {
        for (int i = k + 1; i < COUNT; ++i) {
            const double factor = M[i * COUNT + k] / M[k * COUNT + k];
            for (int j = k; j < COUNT; ++j) {
                M[i * COUNT + j] -= factor * M[k * COUNT + j];
            }
            b[i] -= factor * b[k];
        }
    }
    for (int i = COUNT - 1; i >= 0; --i) {
        for (int j = i + 1; j < COUNT; ++j) {
            b[i] -= M[i * COUNT + j] * b[j];
        }
        b[i] /= M[i * COUNT + i];
    }
}

/*
 * Run from rest at q (which becomes the last position) towards some targets, a pose and a posture each, one after the
 * other; positions: 1 where the posture is commanded, 0 where the pose is. Results: the last reference, the last status of every target, the reason of a fault, and the largest joint speed
 * of the last tenth.
 */
int poses_run(const void *configuration, int targets, int samples, double *q, const double *equilibrium,
              const double *posture, const int *positions, const double *translation, const double *rotation, double *reference,
              unsigned *status, double *speed)
{
    static NAMED(_impedance_state) state;
    const NAMED(_impedance_config) *const config = configuration;
    NAMED(_impedance_input) input;
    NAMED(_impedance_output) output;
    const double gravity[3] = {0.0, 0.0, 0.0};
    double v[COUNT] = {0.0}, matrix[COUNT * COUNT], force[COUNT];
    memset(&input, 0, sizeof input);
    *speed = 0.0;
    if (NAMED(_impedance_init)(config, &state, NULL) != 0) {
        return -1;
    }
    input.sample_valid = 1;
    memcpy(input.translation_stiffness, translation, sizeof input.translation_stiffness);
    memcpy(input.rotation_stiffness, rotation, sizeof input.rotation_stiffness);
    for (int k = 0; k < targets * samples; ++k) {
        memcpy(input.q0, posture + COUNT * (k / samples), sizeof input.q0);
        input.command = positions[k / samples] ? ID(_COMMAND_POSITION) : ID(_COMMAND_EQUILIBRIUM);
        memcpy(input.equilibrium, equilibrium + 16 * (k / samples), sizeof input.equilibrium);
        input.counter += 1u;
        memcpy(input.q, q, sizeof input.q);
        memcpy(input.dq, v, sizeof input.dq);
        NAMED(_impedance_step)(config, &state, &input, &output);
        status[k / samples] = output.status;
        NAMED(_mass_matrix)(q, matrix);
        NAMED(_bias_forces)(q, v, gravity, force);
        for (int i = 0; i < COUNT; ++i) {
            matrix[i * COUNT + i] += config->motor_inertia[i];
            force[i] = output.torque[i] - force[i];
        }
        solve(matrix, force);
        for (int i = 0; i < COUNT; ++i) {
            v[i] += config->sample_time * force[i];
            q[i] += config->sample_time * v[i];
            *speed = k % samples >= samples - samples / 10 ? fmax(*speed, fabs(v[i])) : 0.0;
        }
    }
    memcpy(reference, output.reference, sizeof output.reference);
    return output.reason;
}
