/* Errors that name the argument in place of NumPy's. */
#include "ufuncs.h"

/* Set a TypeError about an argument, which lists the function's arguments. Return NULL. */
PyObject *argument_error(const kernel *k, const char *what, const char *name)
{
    PyObject *names = PyUnicode_FromString(k->argument[0]);
    for (int i = 1; names != NULL && i < k->inputs; ++i) {
        Py_SETREF(names, PyUnicode_FromFormat("%U, %s", names, k->argument[i]));
    }
    if (names != NULL) {
        PyErr_Format(PyExc_TypeError, "%s() %s '%s'; its arguments are %U", k->name, what, name, names);
        Py_DECREF(names);
    }
    return NULL;
}

/* Return whether the dimensions of two arrays before the last ones of each argument do not broadcast. */
static int leading_differ(PyArrayObject *a, int leading_a, PyArrayObject *b, int leading_b)
{
    for (int d = 1; d <= leading_a && d <= leading_b; ++d) {
        const npy_intp x = PyArray_DIM(a, leading_a - d), y = PyArray_DIM(b, leading_b - d);
        if (x != y && x != 1 && y != 1) {
            return 1;
        }
    }
    return 0;
}

/* Set the error about an argument whose leading dimensions differ from those of another one, which are expected. */
static void leading_error(const kernel *k, int i, PyArrayObject *array, int like, PyArrayObject *other)
{
    const int leading = PyArray_NDIM(other) - k->rank[like];
    PyObject *const own = PyObject_GetAttrString((PyObject *)array, "shape");
    PyObject *const others = PyObject_GetAttrString((PyObject *)other, "shape");
    PyObject *const expected = PyTuple_New(leading + k->rank[i]);
    int complete = own != NULL && others != NULL && expected != NULL;
    for (int d = 0; complete && d < leading + k->rank[i]; ++d) {
        PyObject *const extent = PyLong_FromSsize_t(d < leading ? PyArray_DIM(other, d) : k->extent[i][d - leading]);
        complete = extent != NULL && PyTuple_SetItem(expected, d, extent) == 0;
    }
    if (complete) {
        PyErr_Format(PyExc_ValueError, "%s(): %s has the shape %S, expected %S beside %s of the shape %S", k->name,
            k->argument[i], own, expected, k->argument[like], others);
    }
    Py_XDECREF(own);
    Py_XDECREF(others);
    Py_XDECREF(expected);
}

/* Set an error if the leading dimensions of two arguments do not broadcast, and return whether they do not. */
static int explain_leading(const kernel *k, PyObject *const *args, Py_ssize_t count)
{
    PyArrayObject *arrays[MAX_OPERANDS] = {NULL};
    int found = 0;
    for (int i = 0; i < k->inputs && i < count && !found; ++i) {
        arrays[i] = (PyArrayObject *)PyArray_FROM_O(args[i]);
        if (arrays[i] == NULL) {
            PyErr_Clear();
            continue;
        }
        for (int j = 0; j < i && !found; ++j) {
            found = arrays[j] != NULL && leading_differ(arrays[i], PyArray_NDIM(arrays[i]) - k->rank[i],
                arrays[j], PyArray_NDIM(arrays[j]) - k->rank[j]);
            if (found) {
                leading_error(k, i, arrays[i], j, arrays[j]);
            }
        }
    }
    for (int i = 0; i < k->inputs; ++i) {
        Py_XDECREF(arrays[i]);
    }
    return found;
}

/* Set an error if the shape of an argument ends with others than its extents, and return whether it does. */
static int explain_shape(const kernel *k, int i, PyObject *argument)
{
    PyArrayObject *const array = (PyArrayObject *)PyArray_FROM_O(argument);
    if (array == NULL) {
        PyErr_Clear();
        return 0;
    }
    const int leading = PyArray_NDIM(array) - k->rank[i]; /* dimensions of the stack, before those of the argument */
    int fits = leading >= 0;
    for (int d = 0; d < k->rank[i] && fits; ++d) {
        fits = PyArray_DIM(array, leading + d) == k->extent[i][d];
    }
    PyObject *const shape = fits ? NULL : PyObject_GetAttrString((PyObject *)array, "shape");
    Py_DECREF(array);
    if (shape == NULL) {
        return 0;
    }
    PyObject *expected = PyUnicode_FromString("...");
    for (int d = 0; d < k->rank[i] && expected != NULL; ++d) {
        Py_SETREF(expected, PyUnicode_FromFormat("%U, %zd", expected, (Py_ssize_t)k->extent[i][d]));
    }
    if (expected != NULL) {
        PyErr_Format(
            PyExc_ValueError, "%s(): %s has the shape %S, expected (%U)", k->name, k->argument[i], shape, expected);
        Py_DECREF(expected);
    }
    Py_DECREF(shape);
    return 1;
}

/* Replace NumPy's error about a missing argument or a wrong shape by one that names the argument. */
PyObject *explain(const kernel *k, PyObject *const *args, Py_ssize_t count)
{
    if (PyErr_ExceptionMatches(PyExc_TypeError) && count < k->inputs) {
        PyErr_Clear();
        return argument_error(k, "lacks", k->argument[count]);
    }
    if (!PyErr_ExceptionMatches(PyExc_ValueError)) {
        return NULL;
    }
    PyObject *type, *value, *traceback;
    PyErr_Fetch(&type, &value, &traceback);
    int explained = 0;
    for (int i = 0; i < k->inputs && i < count && !explained; ++i) {
        explained = explain_shape(k, i, args[i]);
    }
    if (explained || explain_leading(k, args, count)) {
        Py_XDECREF(type);
        Py_XDECREF(value);
        Py_XDECREF(traceback);
    } else {
        PyErr_Restore(type, value, traceback);
    }
    return NULL;
}
