/* As UNROLLED, for clang too, which would keep these loops. */
#if defined(__clang__)
#define UNROLLED_PRODUCTS _Pragma("clang loop unroll_count(8)")
#else
#define UNROLLED_PRODUCTS UNROLLED
#endif

/* Entry k of the row of J that lane n of block b belongs to; the last row fills the lanes beyond it. */
#define ROW(n) J[stride * (LANES * b + (n) < rows ? LANES * b + (n) : rows - 1) + k]

/*
 * Compute J A^-1 J^T = X^T (D^-1 X), where A = L D L^T and X = L^-1 J^T: its lower triangle, NaN for infinity. J has `rows`
 * rows of n numbers, stride numbers apart; factors has the rows of L, each with its entry of D^-1 in place of the 1 on the
 * diagonal. A lane belongs to a row of J, a block to LANES of them.
 */
static inline void congruence(const {{ scalar.name }} *J, int stride, int rows, const {{ scalar.name }} *factors, int n, {{ scalar.name }} *result)
{
    enum { MOST = ({{ 6 * robot.tips | length }} + LANES - 1) / LANES };
    lanes solved[N][MOST], scaled[N][MOST]; /* X and D^-1 X */
    const int blocks = (rows + LANES - 1) / LANES;
    UNROLLED_PRODUCTS
    for (int k = 0; k < n; ++k) {
        const {{ scalar.name }} *const factor = &factors[k * (k + 1) / 2];
        UNROLLED_PRODUCTS
        for (int b = 0; b < blocks; ++b) {
            lanes x = EACH(ROW); /* row k of X, by forward substitution */
            UNROLLED_PRODUCTS
            for (int i = 0; i < k; ++i) {
                x -= factor[i] * solved[i][b];
            }
            solved[k][b] = x;
            scaled[k][b] = factor[k] * x;
        }
    }
    UNROLLED_PRODUCTS
    for (int i = 0; i < rows; ++i) { /* row i: entry i of solved[k], as numbers, is X_ki */
        lanes row[MOST];
        UNROLLED_PRODUCTS
        for (int b = 0; b <= i / LANES; ++b) {
            lanes sum = ((const {{ scalar.name }} *)solved[0])[i] * scaled[0][b];
            UNROLLED_PRODUCTS
            for (int k = 1; k < n; ++k) {
                sum += ((const {{ scalar.name }} *)solved[k])[i] * scaled[k][b];
            }
            row[b] = sum;
        }
        put_row(result, rows, i, row, 0, i / LANES + 1);
    }
}

#undef ROW
