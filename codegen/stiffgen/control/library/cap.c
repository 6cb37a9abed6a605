/* Caps: springs that are too stiff for the sample time are softened in the directions that are, and only there. */
#include "impedance.h"

static const double FLATTEST = 1e-9; /* least mobility that a cap looks at, over the largest of the spring */
static const double SPRINGS_CAP = 0.95; /* of LARGEST_STIFFNESS for springs: the scale is capped behind them */
static const double SPRINGS_LEAST = 0.25; /* of it that posture and limit avoidance leave to the springs */

/* Turn a vector in the base's axes into those of a pose; NULL: the base's. */
static void turn_to_axes(const double *pose, const double *v, double *turned)
{
    for (int i = 0; i < 3; ++i) {
        turned[i] = pose == NULL ? v[i] : pose[i] * v[0] + pose[4 + i] * v[1] + pose[8 + i] * v[2];
    }
}

/* Compute the mass matrix M at q, with the motors' inertia. */
void compute_inertia(const config_t *c, const memory_t *m, const double *q, double *M)
{
    stiffgen_mass_matrix(q, m, M);
    for (int i = 0; i < N; ++i) {
        M[i * (N + 1)] += c->motor_inertia[i];
    }
}

/*
 * Turn the Jacobian of a tip (6 rows) into that of its springs' displacements: of the centre of stiffness in the axes
 * of the translational stiffness, and of the rotation in those of the rotational one. pose, equilibrium: of the tip.
 */
static void turn_jacobian(const double *pose, const double *equilibrium, double *J)
{
    const double *const from_tip = stiffgen_centre();
    double centre[3]; /* from the tip, in the base's axes */
    for (int i = 0; i < 3; ++i) {
        centre[i] = dot(3, pose + 4 * i, from_tip);
    }
    for (int k = 0; k < N; ++k) {
        double v[3], w[3], turned[3];
        for (int i = 0; i < 3; ++i) {
            w[i] = J[(3 + i) * N + k];
        }
        for (int i = 0; i < 3; ++i) { /* v + w x centre */
            const int a = (i + 1) % 3, b = (i + 2) % 3;
            v[i] = J[i * N + k] + w[a] * centre[b] - w[b] * centre[a];
        }
        turn_to_axes(stiffgen_translation_axes(pose, equilibrium), v, turned);
        for (int i = 0; i < 3; ++i) {
            J[i * N + k] = turned[i];
        }
        turn_to_axes(stiffgen_rotation_axes(pose, equilibrium), w, turned);
        for (int i = 0; i < 3; ++i) {
            J[(3 + i) * N + k] = turned[i];
        }
    }
}

/*
 * Measure the mobilities J M^-1 J^T of each tip's two springs, 3 x 3 each, with J of turn_jacobian. equilibrium: NULL
 * for the poses at q. work: 2 N^2 entries. Return whether M is positive definite.
 */
static int measure_mobilities(const config_t *c, const memory_t *m, const double *q, const double *equilibrium,
                              double *work, double *mobilities)
{
    double *const M = work, *const L = work + NN, J[6 * N * TIPS], pose[16 * TIPS];
    memset(mobilities, 0, 18 * TIPS * sizeof(double));
    compute_inertia(c, m, q, M);
    const double mass = largest_diagonal(N, M);
    if (factorise_cholesky(N, M, mass, 0.0, L) != 0) {
        return 0;
    }
    stiffgen_jacobians(q, m, J);
    stiffgen_poses(q, m, pose);
    for (int t = 0; t < TIPS; ++t) {
        double *const rows = J + 6 * N * t;
        turn_jacobian(pose + 16 * t, equilibrium != NULL ? equilibrium + 16 * t : pose + 16 * t, rows);
        for (int i = 0; i < 6; ++i) {
            solve_forward(N, L, rows + i * N); /* rows L^-T, L L^T = M / mass */
        }
        for (int k = 0; k < 18; ++k) { /* two matrices: entry (i, j) is about rows of one spring */
            const int spring = k / 9 * 3, i = spring + k % 9 / 3, j = spring + k % 3;
            mobilities[18 * t + k] = dot(N, rows + i * N, rows + j * N) / mass;
        }
    }
    return 1;
}

/*
 * Cap a stiffness K (3 x 3): no eigenvalue of K times the mobility A stays above `most`, and directions below it stay
 * as they are. Return the largest eigenvalue before.
 *
 * With A = R^T R, C = R K R^T has these eigenvalues mu, and eigenvectors w. K is the sum of mu u u^T with u = R^-1 w.
 */
static double cap_spring(const double *A, double most, double *K)
{
    double copy[9], d[3], Q[9], C[9], mu[3] = {0.0}, W[9], R[9];
    memcpy(copy, A, sizeof copy);
    if (diagonalise_symmetric(3, copy, d, Q) != 0 || !(d[2] > 0.0)) { /* A = Q^T diag(d) Q */
        return 0.0;
    }
    for (int k = 0; k < 9; ++k) {
        R[k] = sqrt(larger(d[k / 3], FLATTEST * d[2])) * Q[k];
    }
    for (int i = 0; i < 3; ++i) {
        for (int j = 0; j < 3; ++j) {
            double sum = 0.0;
            for (int k = 0; k < 9; ++k) {
                sum += R[3 * i + k / 3] * K[k] * R[3 * j + k % 3];
            }
            C[3 * i + j] = sum;
        }
    }
    if (diagonalise_symmetric(3, C, mu, W) != 0) {
        return 0.0;
    }
    for (int r = 0; r < 3; ++r) {
        double u[3] = {0.0}; /* R^-1 w = Q^T diag(1 / sqrt(d)) w, w: row r of W */
        for (int k = 0; k < 9; ++k) {
            u[k % 3] += W[3 * r + k / 3] * Q[k] / sqrt(larger(d[k / 3], FLATTEST * d[2]));
        }
        for (int k = 0; mu[r] > most && k < 9; ++k) {
            K[k] -= (mu[r] - most) * u[k / 3] * u[k % 3];
        }
    }
    return mu[2];
}

/*
 * Return the level to which each larger value is cut so that all sum up to `most`. Each round shares equally what the
 * values below the level leave; the level rises, and fewer values are above it, until nothing changes.
 */
static double find_level(int count, const double *values, double most)
{
    double level = most / count;
    for (int round = 0; round < count; ++round) {
        double left = most;
        int above = 0;
        for (int k = 0; k < count; ++k) {
            above += values[k] > level;
            left -= values[k] > level ? 0.0 : values[k];
        }
        level = above > 0 ? left / above : HUGE_VAL;
    }
    return level;
}

/*
 * Soften the accepted stiffness where the sample time does not allow it. M^-1 K has no eigenvalue above the sum of
 * those of the springs, of posture and of limit avoidance. Once nothing is cut, the springs are looked at only after
 * the next tangent that is too stiff. A: mobilities of the springs, translation and rotation of each tip in turn.
 */
void cap_springs(step_t *s)
{
    memory_t *const m = s->m;
    double A[18 * TIPS], largest[2 * TIPS], most = SPRINGS_CAP * largest_eigenvalue(s->c, m), sum = 0.0;
    m->stiffness_share = 1.0;
    if (!m->capped) {
        return;
    }
    if (!s->commanded) { /* the stiffness in force is what release_stiffness moves to */
        memcpy(s->translation, m->translation_stiffness, sizeof s->translation);
        memcpy(s->rotation, m->rotation_stiffness, sizeof s->rotation);
    }
    if (!measure_mobilities(s->c, m, m->q, m->equilibrium, s->scratch, A)) {
        return;
    }
    for (int i = 0; i < N; ++i) {
        most -= (m->posture_stiffness[i] + s->limit_slope[i]) / m->inertia[i];
    }
    most = larger(most, SPRINGS_LEAST * largest_eigenvalue(s->c, m));
    for (int k = 0; k < 2 * TIPS; ++k) { /* without a cap: to measure */
        largest[k] = cap_spring(A + 9 * k, HUGE_VAL, (k % 2 == 0 ? s->translation : s->rotation) + 9 * (k / 2));
        sum += largest[k];
    }
    m->capped = sum > most;
    if (!m->capped) {
        return;
    }
    const double level = find_level(2 * TIPS, largest, most);
    for (int k = 0; k < 2 * TIPS; ++k) {
        (void)cap_spring(A + 9 * k, level, (k % 2 == 0 ? s->translation : s->rotation) + 9 * (k / 2));
        m->stiffness_share = smaller(m->stiffness_share, largest[k] > level ? level / largest[k] : 1.0);
    }
    s->status |= ID(STATUS_STIFFNESS_CAPPED);
}

/*
 * Return whether a stiffness at the limits of the configuration would be halved somewhere: in one of POSTURES postures
 * the sample time allows less than half of it.
 */
int halves_stiffness(const config_t *c, const memory_t *m, double *work)
{
    const double half = 2.0 * largest_eigenvalue(c, m);
    int halved = 0;
    for (int k = 0; k < POSTURES; ++k) {
        double q[N], mobilities[18 * TIPS], d[3], Q[9];
        place_posture(c, m, k, q);
        if (!measure_mobilities(c, m, q, NULL, work, mobilities)) {
            continue;
        }
        for (int j = 0; j < 2 * TIPS; ++j) { /* translation and rotation of a tip in turn */
            const double K = j % 2 == 0 ? c->translation_stiffness_limit : c->rotation_stiffness_limit;
            halved |= diagonalise_symmetric(3, mobilities + 9 * j, d, Q) == 0 && K * d[2] > half;
        }
    }
    return halved;
}
