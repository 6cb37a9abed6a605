/* Folds: the arm stretched or folded, where a motion of the joints does not move the tips, and two branches meet. */
#include "follow.h"

static const double NEAR_FOLD = 0.1; /* [m] smallest singular value below which a fold is looked for */
static const double MARGIN = 0.03;   /* [m] that is kept, unless the goal itself is nearer to the fold */
static const double SIDE = 0.003;    /* [m] below which the posture says on which branch the arm is */
static const double NEARBY = 0.05;   /* [rad] up to which the posture is too near to say so */
static const double RATE = 20.0;     /* [1/s] at which the margin is reached */
static const double AHEAD = 1e-4;    /* [rad] of the difference that tells how the tips' motion bends */
static const double FLAT = 0.05;     /* [m] of bend below which there is no fold, as in a wrist; from twice on, all */

/* Improve the joints' motion v (norm 1) that moves the tips least, by an inverse iteration on the shorter side of J. */
static void find_weakest(const double *J, double *weakest, double *v)
{
    double A[SHORT * SHORT], L[SHORT * SHORT];
    for (int i = 0; i < SHORT; ++i) {
        for (int j = 0; j <= i; ++j) {
            double sum = i == j ? DBL_EPSILON : 0.0;
            for (int k = 0; k < LONG; ++k) {
                sum += WIDE ? J[i * N + k] * J[j * N + k] : J[k * N + i] * J[k * N + j];
            }
            A[i * SHORT + j] = sum;
        }
    }
    find_triangle(SHORT, A, L);
    solve_triangles(SHORT, L, weakest);
    const double size = norm(SHORT, weakest);
    for (int k = 0; k < SHORT; ++k) {
        weakest[k] /= size;
    }
    for (int i = 0; i < N; ++i) {
        v[i] = WIDE ? 0.0 : weakest[i];
        for (int k = 0; k < SHORT && WIDE; ++k) {
            v[i] += J[k * N + i] * weakest[k];
        }
    }
    const double length = larger(norm(N, v), DBL_MIN);
    for (int i = 0; i < N; ++i) {
        v[i] /= length;
    }
}

/*
 * Keep a margin to a fold. Along v, by x, the tips go value x + bend x^2 / 2 in the direction u, so at most
 * value^2 / (2 bend) farther out. With the goal beyond that, or well inside, the arm goes no nearer to the fold.
 */
void keep_margin(state_t *s, const step_t *k, double *velocity)
{
    double v[N], q[N], J[ROWS * N], here[ROWS], ahead[ROWS], toward = 0.0;
    find_weakest(k->J, s->weakest, v);
    multiply(k->J, v, here);
    if (norm(ROWS, here) > NEAR_FOLD) {
        return;
    }
    for (int i = 0; i < N; ++i) {
        q[i] = s->q[i] + AHEAD * v[i];
        toward += v[i] * (s->posture[i] - s->q[i]);
    }
    weighed_jacobian(q, k->tool, J);
    multiply(J, v, ahead);
    const double *const u = norm(ROWS, here) > norm(ROWS, ahead) ? here : ahead;
    double value = dot(ROWS, u, here) / norm(ROWS, u), goal = dot(ROWS, u, k->rest) / norm(ROWS, u);
    double bend = (dot(ROWS, u, ahead) / norm(ROWS, u) - value) / AHEAD;
    const int unclear = fabs(value) < SIDE && fabs(toward) > NEARBY;
    const double side = (unclear ? toward : value * bend) < 0.0 ? -1.0 : 1.0; /* of v */
    value *= side * copysign(1.0, bend);
    goal *= copysign(1.0, bend);
    bend = larger(fabs(bend), DBL_EPSILON);
    const double inside = goal + value * value / (2.0 * bend);
    const double margin = MARGIN * smaller(bend / FLAT - 1.0, 1.0), rate = RATE * s->push;
    const double push = rate * (margin - value) / bend - side * dot(N, v, velocity);
    const int bound = bend > FLAT && (inside < 0.0 || (value < SIDE && 2.0 * bend * inside > MARGIN * MARGIN));
    for (int i = 0; i < N && push > 0.0 && bound; ++i) {
        velocity[i] = clamp(velocity[i] + side * push * v[i], k->low[i], k->high[i]);
    }
}
