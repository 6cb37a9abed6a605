#ifndef CALLS_H
#define CALLS_H

/* The robot's functions, and the most operands of one. The generator writes these types into NAME_calls.h, and the
 * functions into NAME_calls.c; tests/support/stub_calls has a robot to compile the file by itself. */
#include "robot.h"

typedef long long casadi_int; /* the type in CasADi's default build */

/* Function of count configurations. Argument k of configuration c is at in[k] + c * steps[k]; results have no gaps. */
typedef void CALL(call)(size_t count, const double *const *in, const ptrdiff_t *steps, double *const *out);

/* Description of a function for CasADi; arrays have its arguments first, then its results. */
typedef struct {
    int inputs;
    int outputs;
    const char *name[MAX_OPERANDS];
    casadi_int shape[MAX_OPERANDS][3]; /* rows, columns, and 1: dense */
    CALL(call) *evaluate;
    CALL(call) *product; /* vector-Jacobian product of the function; NULL for a gradient, which has none */
    int floats; /* nonzero if the first argument is the base's pose */
} CALL(casadi_function);

/* Value, one vector-Jacobian product and all derivatives of a function, for CasADi's matrices; work in doubles. */
void CALL(casadi_evaluate)(const CALL(casadi_function) *f, const double **arg, double **res, double *w);
void CALL(casadi_adjoint)(const CALL(casadi_function) *f, const double **arg, double **res, double *w);
void CALL(casadi_jacobian)(const CALL(casadi_function) *f, const double **arg, double **res, double *w);
casadi_int CALL(casadi_evaluate_work)(const CALL(casadi_function) *f);
casadi_int CALL(casadi_adjoint_work)(const CALL(casadi_function) *f);
casadi_int CALL(casadi_jacobian_work)(const CALL(casadi_function) *f);

/* ---- functions, by file ---- */

#endif
