/* Folds: the arm stretched or folded, where a motion of the joints does not move the tips, and two branches meet. */
#include "follow.h"

static const double NEAR_FOLD = 0.1; /* [m] smallest singular value below which a fold is looked for */
static const double MARGIN = 0.03;   /* [m] that is kept, unless the goal itself is nearer to the fold */
static const double SIDE = 0.003;    /* [m] below which the posture says on which branch the arm is */
static const double NEARBY = 0.05;   /* [rad] up to which the posture is too near to say so */
static const double RATE = 20.0;     /* [1/s] at which the margin is reached */
static const double AHEAD = 1e-4;    /* [rad] of the difference that tells how the tips' motion bends */
static const double FLAT = 0.05;     /* [m] of bend below which there is no fold, as in a wrist; from twice on, all */

/* Improve the joints' motion v (norm 1) that moves the tips least: an inverse iteration on J J^T, or on J^T J. */
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
    divide(SHORT, norm(SHORT, weakest), weakest);
    for (int i = 0; i < N; ++i) {
        v[i] = WIDE ? 0.0 : weakest[i];
        for (int k = 0; k < SHORT && WIDE; ++k) {
            v[i] += J[k * N + i] * weakest[k];
        }
    }
    divide(N, larger(norm(N, v), DBL_MIN), v);
}

/*
 * Fold near the arm, at value = 0. Along v, away from it, by x [rad] the tips go value x + bend x^2 / 2 in a direction
 * u, which is that of the bend: on the arm's branch both are positive.
 */
typedef struct {
    double v[N], value, bend, goal; /* [1] of norm 1, [m/rad], [m/rad^2], [m] from here to the goal along u */
} fold_t;

/* Look for a fold, by the motion v that moves the tips least, here and AHEAD along it. Return whether one is near. */
static int find_fold(state_t *s, const step_t *k, fold_t *fold)
{
    double q[N], J[ROWS * N], here[ROWS], ahead[ROWS], to_posture = 0.0, *const v = fold->v;
    find_weakest(k->J, s->weakest, v);
    multiply(k->J, v, here);
    if (norm(ROWS, here) > NEAR_FOLD) {
        return 0;
    }
    for (int i = 0; i < N; ++i) {
        q[i] = s->q[i] + AHEAD * v[i];
        to_posture += v[i] * (s->posture[i] - s->q[i]);
    }
    weighed_jacobian(q, k->tool, J);
    multiply(J, v, ahead);
    const double *const longer = norm(ROWS, here) > norm(ROWS, ahead) ? here : ahead; /* along u */
    const double length = norm(ROWS, longer), value = dot(ROWS, longer, here) / length;
    const double bend = (dot(ROWS, longer, ahead) / length - value) / AHEAD;
    const int posture_tells = fabs(value) < SIDE && fabs(to_posture) > NEARBY;
    const double away = (posture_tells ? to_posture : value * bend) < 0.0 ? -1.0 : 1.0; /* sign of v */
    divide(N, away, v);
    fold->value = value * (away * copysign(1.0, bend));
    fold->bend = larger(fabs(bend), DBL_EPSILON);
    fold->goal = dot(ROWS, longer, k->rest) / length * copysign(1.0, bend);
    return fold->bend > FLAT;
}

/*
 * Keep a margin to a fold, unless the goal itself is nearer. Against u the tips go at most value^2 / (2 bend) farther,
 * up to value = 0. A goal `inside` of there by so much [m] has the value sqrt(2 bend inside).
 */
void keep_margin(state_t *s, const step_t *k, double *velocity)
{
    fold_t fold;
    if (!find_fold(s, k, &fold)) {
        return;
    }
    const double value = fold.value, bend = fold.bend, inside = fold.goal + value * value / (2.0 * bend);
    const int unreachable = inside < 0.0, well_inside = 2.0 * bend * inside > MARGIN * MARGIN;
    if (unreachable || (value < SIDE && well_inside)) {
        const double margin = MARGIN * smaller(bend / FLAT - 1.0, 1.0), rate = RATE * s->push;
        const double wanted = rate * (margin - value) / bend; /* [rad/s] along v: bend wanted = rate (margin - value) */
        const double push = wanted - dot(N, fold.v, velocity);
        for (int i = 0; i < N && push > 0.0; ++i) {
            velocity[i] = clamp(velocity[i] + push * fold.v[i], k->low[i], k->high[i]);
        }
    }
}
