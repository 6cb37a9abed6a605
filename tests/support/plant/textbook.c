/* SPDX-License-Identifier: MIT */
/* Textbook law to compare with: a Cartesian spring and damper through J^T, and a projected posture spring and damper. */
#include "law.h"

#include "iiwa14.h"

#include <math.h>
#include <string.h>

static const double FORCE = 83.0, MOMENT = 4.2, POSTURE = 1.0, REST = 1.4; /* dampings, posture stiffness and damping */

size_t law_config_size(void) { return sizeof(int); }

size_t law_state_size(void) { return sizeof(int); }

size_t law_output_size(void) { return sizeof(int); }

void law_default_config(void *config) { memset(config, 0, sizeof(int)); }

int law_init(const void *config, void *state, const double *torque, const double *tool) { return config == NULL || state == NULL; }

/* Compute the null vector of J by elimination with pivots; the last column not chosen is free. */
static void null_vector(const double *J, double *n)
{
    double A[6][N], size = 0.0;
    int pivot[6], used[N] = {0};
    memcpy(A, J, sizeof A);
    for (int r = 0; r < 6; ++r) {
        pivot[r] = -1;
        for (int j = 0; j < N; ++j) {
            pivot[r] = !used[j] && (pivot[r] < 0 || fabs(A[r][j]) > fabs(A[r][pivot[r]])) ? j : pivot[r];
        }
        used[pivot[r]] = 1;
        for (int k = 0; k < 6; ++k) {
            const double factor = A[k][pivot[r]] / A[r][pivot[r]];
            for (int j = 0; k != r && j < N; ++j) {
                A[k][j] -= factor * A[r][j];
            }
        }
    }
    for (int j = 0; j < N; ++j) {
        n[j] = used[j] ? 0.0 : 1.0;
        for (int r = 0; !used[j] && r < 6; ++r) {
            n[pivot[r]] = -A[r][j] / A[r][pivot[r]];
        }
    }
    for (int r = 0; r < 6; ++r) { /* the free column may come after some pivots */
        for (int j = 0; j < N; ++j) {
            n[pivot[r]] = used[j] ? n[pivot[r]] : -A[r][j] / A[r][pivot[r]];
        }
    }
    for (int j = 0; j < N; ++j) {
        size += n[j] * n[j];
    }
    for (int j = 0; j < N; ++j) {
        n[j] /= sqrt(size);
    }
}

void law_step(void *state, const sample_t *sample, void *output, command_t *command)
{
    double H[16], E[16], J[6 * N], W[6 * N], F[6], n[N], along = 0.0;
    (void)config;
    (void)state;
    (void)output;
    iiwa14_forward_kinematics(sample->q, H);
    iiwa14_forward_kinematics(sample->wanted, E);
    iiwa14_hybrid_jacobian(sample->q, J);
    iiwa14_hybrid_jacobian(sample->wanted, W);
    for (int r = 0; r < 6; ++r) {
        const int a = (r + 1) % 3, b = (r + 2) % 3;
        double error = E[4 * (r % 3) + 3] - H[4 * (r % 3) + 3], rate = 0.0;
        if (r >= 3) {
            error = 0.0;
            for (int k = 0; k < 3; ++k) {
                error += 0.5 * (E[4 * b + k] * H[4 * a + k] - E[4 * a + k] * H[4 * b + k]);
            }
        }
        for (int j = 0; j < N; ++j) {
            rate += W[r * N + j] * sample->wanted_rate[j] - J[r * N + j] * sample->dq[j];
        }
        F[r] = (r < 3 ? sample->translation[4 * r] : sample->rotation[4 * (r - 3)]) * error + (r < 3 ? FORCE : MOMENT) * rate;
    }
    null_vector(J, n);
    for (int j = 0; j < N; ++j) {
        along += n[j] * (POSTURE * (sample->posture[j] - sample->q[j]) - REST * sample->dq[j]);
    }
    memset(command, 0, sizeof *command);
    for (int j = 0; j < N; ++j) {
        command->torque[j] = along * n[j];
        for (int r = 0; r < 6; ++r) {
            command->torque[j] += J[r * N + j] * F[r];
        }
    }
}
