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

/* Return an argument as an array, or NULL, without an exception, if it is none. */
static PyArrayObject *array_of(PyObject *argument)
{
    PyArrayObject *const array = (PyArrayObject *)PyArray_FROM_O(argument);
    if (array == NULL) {
        PyErr_Clear();
    }
    return array;
}

/* Return the number of dimensions of argument i's stack, which come before those of the argument; negative: too few. */
static int leading_of(const kernel *k, int i, PyArrayObject *array)
{
    return PyArray_NDIM(array) - k->rank[i];
}

/* Return whether the stacks of arguments i and j do not broadcast: some extents, counted from the last, differ. */
static int leading_differ(const kernel *k, int i, PyArrayObject *a, int j, PyArrayObject *b)
{
    const int leading_a = leading_of(k, i, a), leading_b = leading_of(k, j, b);
    for (int d = 1; d <= leading_a && d <= leading_b; ++d) {
        const npy_intp x = PyArray_DIM(a, leading_a - d), y = PyArray_DIM(b, leading_b - d);
        if (x != y && x != 1 && y != 1) {
            return 1;
        }
    }
    return 0;
}

/* Return the shape that argument i must have beside another one: that one's stack, then its own extents. */
static PyObject *shape_beside(const kernel *k, int i, int like, PyArrayObject *other)
{
    const int leading = leading_of(k, like, other);
    PyObject *shape = PyTuple_New(leading + k->rank[i]);
    for (int d = 0; shape != NULL && d < leading + k->rank[i]; ++d) {
        PyObject *const extent = PyLong_FromSsize_t(d < leading ? PyArray_DIM(other, d) : k->extent[i][d - leading]);
        if (extent == NULL || PyTuple_SetItem(shape, d, extent) != 0) {
            Py_CLEAR(shape);
        }
    }
    return shape;
}

/* Set the error about argument i, whose stack differs from that of another one, `like`. */
static void leading_error(const kernel *k, int i, PyArrayObject *array, int like, PyArrayObject *other)
{
    PyObject *const own = PyObject_GetAttrString((PyObject *)array, "shape");
    PyObject *const others = PyObject_GetAttrString((PyObject *)other, "shape");
    PyObject *const expected = shape_beside(k, i, like, other);
    if (own != NULL && others != NULL && expected != NULL) {
        PyErr_Format(PyExc_ValueError, "%s(): %s has the shape %S, expected %S beside %s of the shape %S", k->name,
            k->argument[i], own, expected, k->argument[like], others);
    }
    Py_XDECREF(own);
    Py_XDECREF(others);
    Py_XDECREF(expected);
}

/* Set an error if the stacks of two arguments do not broadcast, and return whether they do not. */
static int explain_leading(const kernel *k, PyObject *const *args, Py_ssize_t count)
{
    PyArrayObject *arrays[MAX_OPERANDS] = {NULL};
    int found = 0;
    for (int i = 0; i < k->inputs && i < count && !found; ++i) {
        arrays[i] = array_of(args[i]);
        for (int j = 0; j < i && arrays[i] != NULL && !found; ++j) {
            found = arrays[j] != NULL && leading_differ(k, i, arrays[i], j, arrays[j]);
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

/* Return whether the shape of argument i ends with its extents. */
static int ends_with_extents(const kernel *k, int i, PyArrayObject *array)
{
    const int leading = leading_of(k, i, array);
    int fits = leading >= 0;
    for (int d = 0; d < k->rank[i] && fits; ++d) {
        fits = PyArray_DIM(array, leading + d) == k->extent[i][d];
    }
    return fits;
}

/* Return the text of the shapes that argument i may have: "..., 6, 7". */
static PyObject *expected_text(const kernel *k, int i)
{
    PyObject *text = PyUnicode_FromString("...");
    for (int d = 0; d < k->rank[i] && text != NULL; ++d) {
        Py_SETREF(text, PyUnicode_FromFormat("%U, %zd", text, (Py_ssize_t)k->extent[i][d]));
    }
    return text;
}

/* Set an error if the shape of argument i does not end with its extents, and return whether it does not. */
static int explain_shape(const kernel *k, int i, PyObject *argument)
{
    PyArrayObject *const array = array_of(argument);
    if (array == NULL) {
        return 0;
    }
    PyObject *shape = NULL;
    if (!ends_with_extents(k, i, array)) {
        shape = PyObject_GetAttrString((PyObject *)array, "shape");
    }
    Py_DECREF(array);
    if (shape == NULL) {
        return 0;
    }
    PyObject *const expected = expected_text(k, i);
    if (expected != NULL) {
        PyErr_Format(
            PyExc_ValueError, "%s(): %s has the shape %S, expected (%U)", k->name, k->argument[i], shape, expected);
        Py_DECREF(expected);
    }
    Py_DECREF(shape);
    return 1;
}

/*
 * Replace NumPy's error about a missing argument or a wrong shape by one that names the argument. args: the count
 * arguments by position. Return NULL.
 */
PyObject *explain(const kernel *k, PyObject *const *args, Py_ssize_t count)
{
    if (PyErr_ExceptionMatches(PyExc_TypeError) && count < k->inputs) {
        PyErr_Clear();
        return argument_error(k, "lacks", k->argument[count]);
    }
    if (!PyErr_ExceptionMatches(PyExc_ValueError)) {
        return NULL;
    }
    PyObject *type, *value, *traceback; /* NumPy's error */
    PyErr_Fetch(&type, &value, &traceback);
    int explained = 0;
    for (int i = 0; i < k->inputs && i < count && !explained; ++i) {
        explained = explain_shape(k, i, args[i]);
    }
    explained = explained || explain_leading(k, args, count);
    if (explained) {
        Py_XDECREF(type);
        Py_XDECREF(value);
        Py_XDECREF(traceback);
    } else {
        PyErr_Restore(type, value, traceback);
    }
    return NULL;
}
