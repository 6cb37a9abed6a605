/* Calls: arguments by name, the loop for floats, errors and warnings. */
#include "ufuncs.h"

static PyObject *argument_names[KERNELS][MAX_OPERANDS];
static vectorcallfunc numpys_call; /* NumPy's own call, the same for every ufunc */

/* Return the index of an argument by its name, or -1 for NumPy's own keywords (out, where, ...). */
static int argument_place(const kernel *k, PyObject *name)
{
    PyObject *const *const names = argument_names[k - kernels];
    for (int i = 0; i < k->inputs; ++i) {
        if (names[i] == name) { /* the usual case: Python interns names in source code */
            return i;
        }
    }
    for (int i = 0; i < k->inputs; ++i) {
        if (PyUnicode_Compare(names[i], name) == 0) {
            return i;
        }
    }
    return -1;
}

/* The type of floats, and names of the arguments that choose a loop; of robots in floats alone. */
static PyObject *float_type, *dtype_name, *other_names[2];

/* Prepare the calls of robots in floats: the names of NumPy's options for the type. Return -1 on failure. */
int prepare_floats(void)
{
    if (NUMBER != NPY_FLOAT) {
        return 0;
    }
    float_type = (PyObject *)PyArray_DescrFromType(NPY_FLOAT);
    dtype_name = PyUnicode_InternFromString("dtype");
    other_names[0] = PyUnicode_InternFromString("signature");
    other_names[1] = PyUnicode_InternFromString("sig");
    return float_type == NULL || dtype_name == NULL || other_names[0] == NULL || other_names[1] == NULL ? -1 : 0;
}

/* Call NumPy's ufunc with dtype=float32: NumPy then converts lists and float64 as far as `casting` allows. */
static PyObject *call_for_floats(PyObject *self, PyObject *const *args, size_t flags, PyObject *keywords)
{
    enum { MAX_ARGUMENTS = 32 };
    PyObject *all[MAX_ARGUMENTS + 1];
    const Py_ssize_t count = PyVectorcall_NARGS(flags), named = keywords == NULL ? 0 : PyTuple_GET_SIZE(keywords);
    int chosen = count + named > MAX_ARGUMENTS;
    for (Py_ssize_t i = 0; i < named && !chosen; ++i) {
        PyObject *const name = PyTuple_GET_ITEM(keywords, i);
        chosen = PyUnicode_Compare(name, dtype_name) == 0 || PyUnicode_Compare(name, other_names[0]) == 0
            || PyUnicode_Compare(name, other_names[1]) == 0;
    }
    if (chosen) { /* the caller has chosen the type, or gives more than any function takes */
        return numpys_call(self, args, flags, keywords);
    }
    /* Vectorcall: named values come behind the others, their names in a tuple. Add dtype as the last one. */
    PyObject *const names = PyTuple_New(named + 1);
    if (names == NULL) {
        return NULL;
    }
    for (Py_ssize_t i = 0; i < named; ++i) {
        PyTuple_SET_ITEM(names, i, Py_NewRef(PyTuple_GET_ITEM(keywords, i)));
    }
    PyTuple_SET_ITEM(names, named, Py_NewRef(dtype_name));
    memcpy(all, args, (size_t)(count + named) * sizeof all[0]);
    all[count + named] = float_type;
    PyObject *const result = numpys_call(self, all, (size_t)count, names);
    Py_DECREF(names);
    return result;
}

/* Call NumPy's ufunc with arguments by position; explain errors, and warn once about likely mistakes. */
static PyObject *checked_call(const kernel *k, PyObject *self, PyObject *const *args, size_t flags, PyObject *keywords)
{
    const vectorcallfunc numpy = NUMBER == NPY_FLOAT ? call_for_floats : numpys_call;
    PyObject *const result = numpy(self, args, flags, keywords);
    if (result == NULL) {
        return explain(k, args, PyVectorcall_NARGS(flags));
    }
    if (warn_of_inputs() < 0) {
        Py_DECREF(result);
        return NULL;
    }
    return result;
}

enum { MAX_OTHERS = 16 };

/* Values of a call by position: a function's arguments in order, then those of NumPy's own keywords (out, where). */
typedef struct {
    PyObject *value[MAX_OPERANDS + MAX_OTHERS];
    PyObject *other[MAX_OTHERS]; /* NumPy's own keywords */
    Py_ssize_t others;
} ordered_call;

/* Put values in order, the first `count` by position, the others by name. Return 0, with an error, for one twice. */
static int order_values(const kernel *k, PyObject *const *args, Py_ssize_t count, PyObject *keywords, ordered_call *c)
{
    for (Py_ssize_t i = 0; i < count; ++i) {
        c->value[i] = args[i];
    }
    for (Py_ssize_t i = 0; i < PyTuple_GET_SIZE(keywords); ++i) {
        PyObject *const name = PyTuple_GET_ITEM(keywords, i);
        const int place = argument_place(k, name);
        if (place < 0) {
            c->value[k->inputs + c->others] = args[count + i];
            c->other[c->others++] = name;
        } else if (c->value[place] != NULL) {
            argument_error(k, "got several values for", k->argument[place]);
            return 0;
        } else {
            c->value[place] = args[count + i];
        }
    }
    return 1;
}

/* Call a ufunc with values in order. Return NULL, with an error, if one lacks. */
static PyObject *ordered_result(const kernel *k, PyObject *self, const ordered_call *c)
{
    PyObject *names = NULL;
    for (int i = 0; i < k->inputs; ++i) {
        if (c->value[i] == NULL) {
            return argument_error(k, "lacks", k->argument[i]);
        }
    }
    if (c->others > 0) {
        names = PyTuple_New(c->others);
        if (names == NULL) {
            return NULL;
        }
    }
    for (Py_ssize_t i = 0; i < c->others; ++i) {
        PyTuple_SET_ITEM(names, i, Py_NewRef(c->other[i]));
    }
    PyObject *const result = checked_call(k, self, c->value, (size_t)k->inputs, names);
    Py_XDECREF(names);
    return result;
}

/* Call a ufunc with named arguments. NumPy's call takes a function's arguments only by position: put them in order. */
static PyObject *call(PyObject *self, PyObject *const *args, size_t flags, PyObject *keywords)
{
    const kernel *const k = (const kernel *)((PyUFuncObject *)self)->data[0];
    if (keywords == NULL) {
        return checked_call(k, self, args, flags, NULL);
    }
    const Py_ssize_t count = PyVectorcall_NARGS(flags), named = PyTuple_GET_SIZE(keywords);
    ordered_call c = {{NULL}, {NULL}, 0};
    if (count > k->inputs || named > MAX_OTHERS) { /* NumPy finds the words for these */
        return checked_call(k, self, args, flags, keywords);
    }
    if (!order_values(k, args, count, keywords, &c)) {
        return NULL;
    }
    const int all_are_numpys = c.others == named;
    return all_are_numpys ? checked_call(k, self, args, flags, keywords) : ordered_result(k, self, &c);
}

/* Make a ufunc accept its arguments by name, and list the names in the module's ARGUMENTS. */
int name_arguments(PyObject *ufunc, int index, PyObject *arguments)
{
    const kernel *const k = &kernels[index];
    PyObject *names = PyTuple_New(k->inputs);
    for (int i = 0; names != NULL && i < k->inputs; ++i) {
        PyObject *name = PyUnicode_InternFromString(k->argument[i]);
        if (name == NULL) {
            Py_CLEAR(names);
        } else {
            argument_names[index][i] = Py_NewRef(name);
            PyTuple_SET_ITEM(names, i, name);
        }
    }
    const int failed = names == NULL || PyDict_SetItemString(arguments, k->name, names) < 0;
    Py_XDECREF(names);
    numpys_call = ((PyUFuncObject *)ufunc)->vectorcall;
    ((PyUFuncObject *)ufunc)->vectorcall = call;
    return failed ? -1 : 0;
}
