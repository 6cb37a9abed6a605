/* Search for a posture, for Python. */
#include "controller.h"

/* Search: arguments (numbers, bounds, posture); numbers: poses, poses of tools and start; bounds: lower and upper, or
 * None. Return the error's code. */
static PyObject *find_posture(PyObject *module, PyObject *arguments)
{
    enum { POSTURE = MOTORS, POSES = 16 * TIPS }; /* numbers in one posture, in the poses of all tips */
    Py_buffer numbers, bounds, posture;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*z*w*", &numbers, &bounds, &posture)) {
        return NULL;
    }
    const int is_bounded = bounds.buf != NULL;
    const double *const poses = structs(&numbers, (2 * POSES + POSTURE) * sizeof *poses, 1);
    const double *const lower = is_bounded ? structs(&bounds, 2 * POSTURE * sizeof *lower, 1) : NULL;
    double *const found = structs(&posture, POSTURE * sizeof *found, 1);
    if (poses != NULL && found != NULL && (!is_bounded || lower != NULL)) {
        const double *const tools = poses + POSES, *const start = tools + POSES;
        const double *const upper = is_bounded ? lower + POSTURE : NULL;
        int code = 0;
        Py_BEGIN_ALLOW_THREADS
        code = CALL(find_posture)(poses, tools, start, lower, upper, found);
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
