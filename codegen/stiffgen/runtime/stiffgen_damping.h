/*
 * Damping design from joint stiffness and mass matrix, and the symmetric eigensolver under it.
 *
 * Matrices are dense, row-major, n x n with n the number of joints (no padding). Units are those of the arguments:
 * with N m/rad and kg m^2, eigenvalues are in 1/s^2 and damping in N m s/rad.
 *
 * Contract of every function
 *   Plain C99 and libm; allocation-free, reentrant, deterministic, bounded time; no global.
 *   Returns STIFFGEN_OK or a negative code (stiffgen_error.h); after an error the results are unspecified.
 *   The results must overlap neither an argument nor one another. work: STIFFGEN_WORK(n) doubles of scratch.
 *
 * Sources
 *   A. Albu-Schaeffer, C. Ott, U. Frese, G. Hirzinger, "Cartesian impedance control of redundant robots: recent
 *   results with the DLR-light-weight-arms", ICRA 2003: double diagonalisation and factorisation design.
 *   G. Golub, C. Van Loan, Matrix Computations: Cholesky reduction (8.7), cyclic Jacobi (8.5).
 */
#define STIFFGEN_MAX_DOF 32
#define STIFFGEN_WORK(n) (4 * (n) * (n))

/*
 * Eigenvalues and orthonormal eigenvectors of a symmetric matrix A, by cyclic Jacobi rotations.
 *
 * eigenvalues (n): ascending. vectors (n x n): column k belongs to eigenvalue k.
 * Errors: SIZE, NOT_FINITE, NOT_SYMMETRIC (by more than 1e-9 of the largest entry), NOT_CONVERGED.
 */
static int stiffgen_eigen_symmetric(int n, const double *A, double *eigenvalues, double *vectors, double *work);

/*
 * Generalised eigenproblem K v = lambda M v with V^T M V = I, by Cholesky reduction and cyclic Jacobi.
 *
 * stiffness K: symmetric, may be indefinite. mass M: symmetric positive definite.
 * eigenvalues (n): ascending. vectors V (n x n): column k belongs to eigenvalue k.
 * Errors: those of stiffgen_eigen_symmetric, MASS.
 */
static int stiffgen_eigen_generalised(int n, const double *stiffness, const double *mass, double *eigenvalues,
                               double *vectors, double *work);

/*
 * Double diagonalisation: B = M V diag(2 zeta_k sqrt(max(lambda_k, 0))) V^T M, K v = lambda M v, V^T M V = I.
 *
 * Symmetric and positive semidefinite. Every mode with lambda > 0 gets its damping ratio, the others no damping:
 * eigenvalues[0] < 0 tells that the stiffness is indefinite.
 * ratio (n): zeta of the modes in ascending order of lambda, 0 or more.
 * eigenvalues (n): lambda, ascending [1/s^2].
 * Errors: those of stiffgen_eigen_generalised, DAMPING_RATIO.
 */
static int stiffgen_damping_modal(int n, const double *stiffness, const double *mass, const double *ratio, double *damping,
                           double *eigenvalues, double *work);

/*
 * Factorisation design: B = A D K1 + K1 D A with A A = M, K1 K1 = K (its positive part), D = diag(ratio).
 *
 * Symmetric; positive semidefinite only if A D K1 + K1 D A happens to be: take stiffgen_positive_part of it before
 * use. ratio (n): of the joints, 0 or more.
 * Errors: those of stiffgen_eigen_symmetric, MASS, DAMPING_RATIO.
 */
static int stiffgen_damping_factorised(int n, const double *stiffness, const double *mass, const double *ratio,
                                double *damping, double *work);

/*
 * Task damping mapped to the joints: B = J^T task_damping J + joint_damping I, as the paper's code has it.
 *
 * jacobian (6 x n); task_damping (6 x 6): symmetric, only its upper triangle is read. Bitwise symmetric.
 * Errors: SIZE.
 */
static int stiffgen_damping_task(int n, const double *jacobian, const double *task_damping, double joint_damping,
                          double *damping);

/*
 * The part of a symmetric matrix with eigenvalues of 0 or more: A V = V Lambda, result V max(Lambda, 0) V^T.
 *
 * metric: NULL for plain eigenvalues, or a mass matrix M for those of the pencil, result M V max(Lambda, 0) V^T M.
 * A comes back bit for bit where it has no negative eigenvalue.
 * eigenvalues (n): before, ascending.
 */
static int stiffgen_positive_part(int n, const double *A, const double *metric, double *result, double *eigenvalues,
                           double *work);

/*
 * Nullspace stiffness N (k I) N^T with the torque projector N = I - J^T Lambda J M^-1, Lambda = (J M^-1 J^T)^-1.
 *
 * N J^T = 0: its torques cause no tip acceleration (Khatib 1987). Symmetric and positive semidefinite. The inverse is
 * taken in the eigenbasis of J M^-1 J^T scaled to a unit diagonal, so that the mixed units of its rows do not matter;
 * eigenvalues s below the threshold e are damped, 1/s -> s/(s^2 + (e^2 - s^2)) = s/e^2 (after Nakamura and Hanafusa
 * 1986): exact above it, continuous across it, and a direction that is lost at a singularity is left to the nullspace.
 * jacobian (6 x n) in any representation; threshold: dimensionless, 1e-9 to 1.
 * smallest: the smallest scaled eigenvalue of the directions that the chain can move at all.
 * Errors: those of stiffgen_eigen_symmetric, MASS.
 */
static int stiffgen_nullspace_stiffness(int n, const double *jacobian, const double *mass, double k, double threshold,
                                 double *stiffness, double *smallest, double *work);

/* Whether a 6 x 6 matrix is finite, symmetric to 1e-9 of its largest entry, and positive semidefinite to the same. */
static int stiffgen_is_positive_semidefinite6(const double *A);
