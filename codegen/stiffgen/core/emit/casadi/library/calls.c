/* Values and derivatives of a function for CasADi: copies between its column-major matrices and row-major ones. */
#include "calls.h"

static casadi_int size_of(const CALL(casadi_function) *f, int operand)
{
    return f->shape[operand][0] * f->shape[operand][1];
}

/* Return the numbers of the operands first, ..., end - 1 together. */
static casadi_int size_of_all(const CALL(casadi_function) *f, int first, int end)
{
    casadi_int size = 0;
    for (int o = first; o < end; ++o) {
        size += size_of(f, o);
    }
    return size;
}

/* Copy a row-major matrix to a column-major one. */
static void to_column_major(const double *from, casadi_int rows, casadi_int columns, double *to)
{
    for (casadi_int r = 0; r < rows; ++r) {
        for (casadi_int c = 0; c < columns; ++c) {
            to[r + c * rows] = from[r * columns + c];
        }
    }
}

/* Copy an operand from CasADi to the work space, row-major; NULL means zero. Return the rest of the work space. */
static double *load_operand(const CALL(casadi_function) *f, int operand, const double *from, double *w)
{
    const casadi_int size = size_of(f, operand);
    if (from != NULL) { /* the transpose of a column-major matrix is a row-major one, with rows and columns exchanged */
        to_column_major(from, f->shape[operand][1], f->shape[operand][0], w);
    }
    for (casadi_int k = 0; from == NULL && k < size; ++k) {
        w[k] = 0.0;
    }
    return w + size;
}

/* Copy a result to CasADi, column-major, unless CasADi does not ask for it (NULL). */
static void store_result(const CALL(casadi_function) *f, int operand, const double *from, double *to)
{
    if (to != NULL) {
        to_column_major(from, f->shape[operand][0], f->shape[operand][1], to);
    }
}

/* Evaluate a function for CasADi: arguments and results are column-major there, row-major here; w is work space. */
void CALL(casadi_evaluate)(const CALL(casadi_function) *f, const double **arg, double **res, double *w)
{
    const double *in[MAX_OPERANDS];
    double *out[MAX_OPERANDS];
    const ptrdiff_t steps[MAX_OPERANDS] = {0};
    for (int o = 0; o < f->inputs; ++o) {
        in[o] = w;
        w = load_operand(f, o, arg[o], w);
    }
    for (int o = 0; o < f->outputs; ++o) {
        out[o] = w;
        w += size_of(f, f->inputs + o);
    }
    f->evaluate(1, in, steps, out);
    for (int o = 0; o < f->outputs; ++o) {
        store_result(f, f->inputs + o, out[o], res[o]);
    }
}

casadi_int CALL(casadi_evaluate_work)(const CALL(casadi_function) *f)
{
    return size_of_all(f, 0, f->inputs + f->outputs);
}

/*
 * Convert covectors (f, m) of the base's twist, one per configuration, in place to gradients with respect to the
 * entries of the base's pose (4 x 4): (R [m]/2, R f), where [m] is the matrix of m x, and 0 in the last row. Of all
 * matrices with the same product with every motion of the pose, this one has the smallest norm. The last configuration
 * comes first, since 16 numbers take the place of 6.
 */
static void to_entry_gradients(size_t count, const double *pose, double *bar)
{
    for (size_t n = count; n-- > 0;) {
        const double *const f = bar + 6 * n, *const m = f + 3;
        double *const gradient = bar + 16 * n;
        const double motion[3][4] = {
            {0.0, -0.5 * m[2], 0.5 * m[1], f[0]},
            {0.5 * m[2], 0.0, -0.5 * m[0], f[1]},
            {-0.5 * m[1], 0.5 * m[0], 0.0, f[2]},
        };
        for (int i = 0; i < 4; ++i) {
            const double *const row = pose + 4 * i;
            for (int j = 0; j < 4; ++j) {
                const double sum = row[0] * motion[0][j] + row[1] * motion[1][j] + row[2] * motion[2][j];
                gradient[4 * i + j] = i < 3 ? sum : 0.0;
            }
        }
    }
}

/* Compute gradients with respect to the arguments. arg: arguments, results (not read), one cotangent per result. */
void CALL(casadi_adjoint)(const CALL(casadi_function) *f, const double **arg, double **res, double *w)
{
    const double *in[MAX_OPERANDS];
    double *out[MAX_OPERANDS];
    const ptrdiff_t steps[MAX_OPERANDS] = {0};
    for (int o = 0; o < f->inputs + f->outputs; ++o) {
        in[o] = w;
        w = load_operand(f, o, arg[o < f->inputs ? o : o + f->outputs], w);
    }
    for (int o = 0; o < f->inputs; ++o) {
        out[o] = w;
        w += size_of(f, o);
    }
    f->product(1, in, steps, out);
    if (f->floats) {
        to_entry_gradients(1, in[0], out[0]);
    }
    for (int o = 0; o < f->inputs; ++o) {
        store_result(f, o, out[o], res[o]);
    }
}

casadi_int CALL(casadi_adjoint_work)(const CALL(casadi_function) *f)
{
    return CALL(casadi_evaluate_work)(f) + size_of_all(f, 0, f->inputs);
}

/*
 * Write one cotangent of a result (rows x columns) per entry of it: 1 at the entry, else 0. The entries are counted
 * column by column, as CasADi counts the rows of a Jacobian; a cotangent is row-major. Return the rest of the work
 * space.
 */
static double *unit_cotangents(casadi_int rows, casadi_int columns, double *w)
{
    const casadi_int entries = rows * columns;
    for (casadi_int k = 0; k < entries * entries; ++k) {
        w[k] = 0.0;
    }
    for (casadi_int e = 0; e < entries; ++e) {
        const casadi_int row = e % rows, column = e / rows;
        w[e * entries + row * columns + column] = 1.0;
    }
    return w + entries * entries;
}

/*
 * Copy gradients with respect to an argument (rows x columns), one row-major matrix per entry of the result, to columns
 * of CasADi's Jacobian: its column-major matrix has a row per entry of the result, a column per entry of the argument.
 */
static void store_gradients(const double *from, casadi_int entries, casadi_int rows, casadi_int columns, double *to)
{
    for (casadi_int r = 0; r < rows; ++r) {
        for (casadi_int c = 0; c < columns; ++c) {
            for (casadi_int e = 0; e < entries; ++e) {
                to[(r + c * rows) * entries + e] = from[e * rows * columns + r * columns + c];
            }
        }
    }
}

/*
 * Compute the derivative of every result with respect to every argument, one row per entry of the result. arg:
 * arguments, results (not read). Each result takes one batch of products, with one unit cotangent per entry and zeros
 * for the other results.
 */
void CALL(casadi_jacobian)(const CALL(casadi_function) *f, const double **arg, double **res, double *w)
{
    const double *in[MAX_OPERANDS];
    double *out[MAX_OPERANDS];
    for (int o = 0; o < f->inputs; ++o) {
        in[o] = w;
        w = load_operand(f, o, arg[o], w);
    }
    for (int r = 0; r < f->outputs; ++r) {
        const casadi_int entries = size_of(f, f->inputs + r);
        ptrdiff_t steps[MAX_OPERANDS] = {0}; /* arguments and zeros are shared by the batch */
        double *left = w;
        steps[f->inputs + r] = (ptrdiff_t)entries;
        for (int o = f->inputs; o < f->inputs + f->outputs; ++o) {
            in[o] = left;
            left = o == f->inputs + r ? unit_cotangents(f->shape[o][0], f->shape[o][1], left)
                                      : load_operand(f, o, NULL, left);
        }
        for (int o = 0; o < f->inputs; ++o) {
            out[o] = left;
            left += entries * size_of(f, o);
        }
        f->product((size_t)entries, in, steps, out);
        if (f->floats) {
            to_entry_gradients((size_t)entries, in[0], out[0]);
        }
        for (int o = 0; o < f->inputs; ++o) {
            double *const to = res[r * f->inputs + o];
            if (to != NULL) {
                store_gradients(out[o], entries, f->shape[o][0], f->shape[o][1], to);
            }
        }
    }
}

/* Return the work space of the Jacobian, in numbers: that of the largest result's products. */
casadi_int CALL(casadi_jacobian_work)(const CALL(casadi_function) *f)
{
    const casadi_int inputs = size_of_all(f, 0, f->inputs), outputs = size_of_all(f, f->inputs, f->inputs + f->outputs);
    casadi_int most = 0;
    for (int r = 0; r < f->outputs; ++r) {
        const casadi_int entries = size_of(f, f->inputs + r), size = outputs + entries * (entries + inputs);
        most = size > most ? size : most;
    }
    return inputs + most;
}
