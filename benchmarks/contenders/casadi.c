/* SPDX-License-Identifier: MIT */
/* C that CasADi generated, called with its work arrays on the stack. SOURCE and FUNCTION come from the command line. */
#include SOURCE

void run(const double *q, const double *wrench, const double *task_stiffness, double *joint_stiffness)
{
    const casadi_real *arguments[16] = {q, wrench, task_stiffness};
    casadi_real *results[16] = {joint_stiffness};
    static casadi_int iw[1];
    static casadi_real w[WORK];
    FUNCTION(arguments, results, iw, w, 0);
}
