/* Search for a posture, for Python. */
#include "controller.h"

/* Search: arguments (numbers, bounds, posture); numbers: poses, poses of tools and start; bounds: lower and upper, or
 * None. Return the error's code. */
static PyObject *find_posture(PyObject *module, PyObject *arguments)
{
    enum { N = MOTORS, POSES = 16 * TIPS }; /* numbers in one posture, in the poses of all tips */
    Py_buffer numbers, bounds, posture;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*z*w*", &numbers, &bounds, &posture)) {
        return NULL;
    }
    const double *x = structs(&numbers, (2 * POSES + N) * sizeof(double), 1), *limits = NULL;
    double *y = x != NULL ? structs(&posture, N * sizeof(double), 1) : NULL;
    if (y != NULL && bounds.buf != NULL) {
        limits = structs(&bounds, 2 * N * sizeof(double), 1);
        y = limits != NULL ? y : NULL;
    }
    if (y != NULL) {
        int code = 0;
        Py_BEGIN_ALLOW_THREADS
        code = CALL(find_posture)(x, x + POSES, x + 2 * POSES, limits, limits != NULL ? limits + N : NULL, y);
        Py_END_ALLOW_THREADS
        result = PyLong_FromLong(code);
    }
    PyBuffer_Release(&numbers);
    PyBuffer_Release(&bounds);
    PyBuffer_Release(&posture);
    return result;
}

/* Return an error in words: argument (code). */
static PyObject *find_posture_error_text(PyObject *module, PyObject *arguments)
{
    int code;
    (void)module;
    return PyArg_ParseTuple(arguments, "i", &code) ? PyUnicode_FromString(CALL(find_posture_error_text)(code)) : NULL;
}

static PyMethodDef find_posture_methods[] = {
    {"find_posture", find_posture, METH_VARARGS, NULL},
    {"find_posture_error_text", find_posture_error_text, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

/* Add the search to the module. */
int add_find_posture(PyObject *module)
{
    return PyModule_AddFunctions(module, find_posture_methods);
}
