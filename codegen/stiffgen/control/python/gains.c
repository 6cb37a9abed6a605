/* Gains for Python. */
#include "controller.h"

/* Split a torque for motors: arguments (numbers, results), in the order of the C function. Return the error's code. */
static PyObject *joint_gains(PyObject *module, PyObject *arguments)
{
    enum { N = MOTORS };
    Py_buffer numbers, results;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*w*", &numbers, &results)) {
        return NULL;
    }
    const double *x = structs(&numbers, (7 * N + 2 * N * N) * sizeof(double), 1);
    double *y = x != NULL ? structs(&results, 3 * N * sizeof(double), 1) : NULL;
    if (y != NULL) {
        const double *const limits = x + 5 * N + 2 * N * N;
        result = PyLong_FromLong(CALL(joint_gains)(x, x + N, x + 2 * N, x + 3 * N, x + 4 * N, x + 5 * N,
            x + 5 * N + N * N, limits, limits + N, y, y + N, y + 2 * N));
    }
    PyBuffer_Release(&numbers);
    PyBuffer_Release(&results);
    return result;
}

/* Bound the work of motors whose host is late: arguments (numbers, hold), in the order of the C function. */
static PyObject *late_work(PyObject *module, PyObject *arguments)
{
    enum { N = MOTORS };
    Py_buffer numbers;
    double hold;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*d", &numbers, &hold)) {
        return NULL;
    }
    const double *x = structs(&numbers, 7 * N * sizeof(double), 1);
    if (x != NULL) {
        result = PyFloat_FromDouble(CALL(late_work)(x, x + N, x + 2 * N, x + 3 * N, x + 4 * N, x + 5 * N, x + 6 * N,
            hold));
    }
    PyBuffer_Release(&numbers);
    return result;
}

static PyMethodDef gains_methods[] = {
    {"joint_gains", joint_gains, METH_VARARGS, NULL},
    {"late_work", late_work, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

/* Add the functions of gains to the module. */
int add_gains(PyObject *module)
{
    return PyModule_AddFunctions(module, gains_methods);
}
