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
    if (from != NULL) {
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
 * entries of the base's pose: (R [m]/2, R f). Of all matrices with the same product with every motion of the pose, this
 * one has the smallest norm.
 */
static void to_entry_gradients(size_t count, const double *pose, double *bar)
{
    for (size_t c = count; c-- > 0;) {
        const double *const b = bar + 6 * c;
        const double motion[3][4] = {
            {0.0, -0.5 * b[5], 0.5 * b[4], b[0]},
            {0.5 * b[5], 0.0, -0.5 * b[3], b[1]},
            {-0.5 * b[4], 0.5 * b[3], 0.0, b[2]},
        };
        for (int k = 0; k < 16; ++k) {
            const double *const row = pose + k / 4 * 4;
            const double sum = row[0] * motion[0][k % 4] + row[1] * motion[1][k % 4] + row[2] * motion[2][k % 4];
            bar[16 * c + (size_t)k] = k < 12 ? sum : 0.0;
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
 * Compute the derivative of every result with respect to every argument, one row per entry of the result. arg:
 * arguments, results (not read). Each result takes one batch of products, with one unit cotangent per entry.
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
        const casadi_int rows = f->shape[f->inputs + r][0], columns = f->shape[f->inputs + r][1];
        const casadi_int entries = rows * columns;
        ptrdiff_t steps[MAX_OPERANDS] = {0};
        double *left = w;
        for (int o = 0; o < f->outputs; ++o) {
            const casadi_int size = size_of(f, f->inputs + o) * (o == r ? entries : 1);
            for (casadi_int k = 0; k < size; ++k) {
                left[k] = 0.0;
            }
            for (casadi_int e = 0; o == r && e < entries; ++e) {
                left[e * entries + e % rows * columns + e / rows] = 1.0; /* entry e, counted column by column */
            }
            steps[f->inputs + o] = o == r ? (ptrdiff_t)entries : 0;
            in[f->inputs + o] = left;
            left += size;
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
            const casadi_int height = f->shape[o][0], width = f->shape[o][1], size = height * width;
            double *const to = res[r * f->inputs + o];
            for (casadi_int k = 0; to != NULL && k < size; ++k) {
                for (casadi_int e = 0; e < entries; ++e) {
                    to[(k / width + k % width * height) * entries + e] = out[o][e * size + k];
                }
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
