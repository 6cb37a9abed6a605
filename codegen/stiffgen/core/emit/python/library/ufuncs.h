/*
 * NumPy generalised ufuncs over a table of kernels: copies of operands with gaps, looks at suspicious inputs, arguments
 * by name, and errors that name the argument. The inner loops run without the GIL.
 */
#ifndef UFUNCS_H
#define UFUNCS_H

/* Python and NumPy, the robot's name, its type of number, sizes and limits. The generator writes them and the table of
 * kernels, and these files with all functions static, into NAME_python.c; tests/support/stub_module has a robot to
 * compile the files by themselves, where C_INCLUDE_PATH names the headers of Python and NumPy. */
#include "robot.h"

#include <string.h>

enum { MAX_RANK = 3, CHUNK = 64 };

typedef struct {
    const char *name;
    const char *signature;
    const char *documentation;
    int inputs;
    int operands; /* inputs, then outputs */
    const char *argument[MAX_OPERANDS];
    char check[MAX_OPERANDS]; /* of inputs: 'q' joint positions, 't' stiffness that should be symmetric, else '-' */
    int rank[MAX_OPERANDS];
    npy_intp extent[MAX_OPERANDS][MAX_RANK];
    void (*evaluate)(const number *const *in, number *const *out); /* NULL: batches only */
    /* count configurations, steps between them in numbers; NULL where the C code has no batch */
    void (*evaluate_batch)(size_t count, const number *const *in, const npy_intp *steps, number *const *out);
} kernel;

/* ---- functions, by file ---- */

extern kernel kernels[KERNELS];
extern const number turn_limits[POSITIONS];

int self_check(void);

/* operands.c */
npy_intp size_of(const kernel *k, int operand);
int is_direct(const kernel *k, int operand, const char *block, npy_intp outer, const npy_intp *steps);
int is_batch(const kernel *k, int operand, const char *block, npy_intp outer, const npy_intp *steps);
void copy_block(const kernel *k, int operand, char *block, const npy_intp *steps, number *packed, int pack);

/* inputs.c */
void look_at_inputs(const kernel *k, char **args, npy_intp count, const npy_intp *steps);
int warn_of_inputs(void);

/* loop.c */
void loop(char **args, const npy_intp *dimensions, const npy_intp *steps, void *data);

/* explain.c */
PyObject *argument_error(const kernel *k, const char *what, const char *name);
PyObject *explain(const kernel *k, PyObject *const *args, Py_ssize_t count);

/* call.c */
int name_arguments(PyObject *ufunc, int index, PyObject *arguments);
int prepare_floats(void);

/* load.c */
int add_functions(PyObject *module);

#endif
