/* Controller for Python: structs pass as buffers, and lists tell their layout. */
#include "controller.h"

/*
 * Return a buffer that holds at least `count` structs of a size, or NULL with an exception. A function may look at all
 * of its buffers before it returns: each sets the same exception.
 */
void *structs(const Py_buffer *buffer, size_t size, Py_ssize_t count)
{
    if (count < 0 || (size_t)buffer->len / size < (size_t)count || (uintptr_t)buffer->buf % sizeof(double) != 0) {
        PyErr_SetString(PyExc_ValueError, "a buffer is too small or not aligned");
        return NULL;
    }
    return buffer->buf;
}

/* Write the default configuration: argument (config). */
static PyObject *default_config(PyObject *module, PyObject *arguments)
{
    Py_buffer config;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*", &config)) {
        return NULL;
    }
    config_t *const c = structs(&config, sizeof *c, 1);
    if (c != NULL) {
        CALL(impedance_default_config)(c);
    }
    PyBuffer_Release(&config);
    return c != NULL ? Py_NewRef(Py_None) : NULL;
}

/* Initialise: arguments (config, state, torque), torque a buffer of MOTORS doubles. */
static PyObject *initialise(PyObject *module, PyObject *arguments)
{
    Py_buffer config, state, torque;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*w*y*", &config, &state, &torque)) {
        return NULL;
    }
    const config_t *const c = structs(&config, sizeof *c, 1);
    state_t *const s = structs(&state, sizeof *s, 1);
    const double *const tau = structs(&torque, MOTORS * sizeof *tau, 1);
    if (c != NULL && s != NULL && tau != NULL) {
        result = PyLong_FromLong(CALL(impedance_init)(c, s, tau));
    }
    PyBuffer_Release(&config);
    PyBuffer_Release(&state);
    PyBuffer_Release(&torque);
    return result;
}

/* Reset a fault: argument (state). Return the error's code. */
static PyObject *reset(PyObject *module, PyObject *arguments)
{
    Py_buffer state;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*", &state)) {
        return NULL;
    }
    state_t *const s = structs(&state, sizeof *s, 1);
    if (s != NULL) {
        result = PyLong_FromLong(CALL(impedance_reset)(s));
    }
    PyBuffer_Release(&state);
    return result;
}

/* Run steps without the GIL, up to the first error: arguments (state, inputs, outputs, count). */
static PyObject *run(PyObject *module, PyObject *arguments)
{
    Py_buffer state, inputs, outputs;
    Py_ssize_t count;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*y*w*n", &state, &inputs, &outputs, &count)) {
        return NULL;
    }
    state_t *const s = structs(&state, sizeof *s, 1);
    const input_t *const in = structs(&inputs, sizeof *in, count);
    output_t *const out = structs(&outputs, sizeof *out, count);
    if (s != NULL && in != NULL && out != NULL) {
        int code = ID(OK);
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t k = 0; k < count && code == ID(OK); ++k) {
            code = CALL(impedance_step)(s, in + k, out + k);
        }
        Py_END_ALLOW_THREADS
        result = PyLong_FromLong(code);
    }
    PyBuffer_Release(&state);
    PyBuffer_Release(&inputs);
    PyBuffer_Release(&outputs);
    return result;
}

/* Describe an output in the words that a function of the controller writes: argument (output). */
static PyObject *describe(PyObject *arguments, int (*write)(const output_t *, char *, size_t))
{
    Py_buffer output;
    char text[1024] = "";
    if (!PyArg_ParseTuple(arguments, "y*", &output)) {
        return NULL;
    }
    const output_t *const out = structs(&output, sizeof *out, 1);
    if (out != NULL) {
        write(out, text, sizeof text);
    }
    PyBuffer_Release(&output);
    return out != NULL ? PyUnicode_DecodeUTF8(text, (Py_ssize_t)strlen(text), "replace") : NULL;
}

static PyObject *fault_text(PyObject *module, PyObject *arguments)
{
    (void)module;
    return describe(arguments, CALL(impedance_fault_text));
}

static PyObject *refusal_text(PyObject *module, PyObject *arguments)
{
    (void)module;
    return describe(arguments, CALL(impedance_refusal_text));
}

static PyObject *error_text(PyObject *module, PyObject *arguments)
{
    int code;
    (void)module;
    return PyArg_ParseTuple(arguments, "i", &code) ? PyUnicode_FromString(CALL(impedance_error_text)(code)) : NULL;
}

static PyMethodDef controller_methods[] = {
    {"default_config", default_config, METH_VARARGS, NULL},
    {"initialise", initialise, METH_VARARGS, NULL},
    {"reset", reset, METH_VARARGS, NULL},
    {"run", run, METH_VARARGS, NULL},
    {"fault_text", fault_text, METH_VARARGS, NULL},
    {"refusal_text", refusal_text, METH_VARARGS, NULL},
    {"error_text", error_text, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

/* Add a list or table to the module; steals the reference. Return -1 without one, too: its error is set. */
static int add(PyObject *module, const char *name, PyObject *list)
{
    const int error = list == NULL || PyModule_AddObjectRef(module, name, list) < 0;
    Py_XDECREF(list);
    return error ? -1 : 0;
}

/* Append an item to a list; steals the reference. Return -1 without an item, too: its error is set. */
static int append(PyObject *list, PyObject *item)
{
    const int error = item == NULL || PyList_Append(list, item) < 0;
    Py_XDECREF(item);
    return error ? -1 : 0;
}

/* Return a list of (field, word, number): the words that Python takes in place of numbers. */
static PyObject *list_words(const choice *first, int count)
{
    PyObject *list = PyList_New(0);
    for (int i = 0; list != NULL && i < count; ++i) {
        if (append(list, Py_BuildValue("(ssi)", first[i].field, first[i].word, first[i].value)) < 0) {
            Py_CLEAR(list);
        }
    }
    return list;
}

/* Return a list of the structs' fields: struct, name, format, offset, shape, whether unbounded, unit, heading. */
static PyObject *list_fields(void)
{
    PyObject *list = PyList_New(0);
    for (int i = 0; list != NULL && i < FIELDS; ++i) {
        const field *const f = &fields[i];
        PyObject *const shape = PyTuple_New(f->rank);
        PyObject *item = NULL;
        for (int k = 0; shape != NULL && k < f->rank; ++k) {
            PyTuple_SET_ITEM(shape, k, PyLong_FromLong(f->extent[k]));
        }
        if (shape != NULL) { /* N: BuildValue takes over the reference */
            item = Py_BuildValue("(sssnNNss)", f->structure, f->name, f->format, (Py_ssize_t)f->offset, shape,
                PyBool_FromLong(f->unbounded), f->unit, f->heading);
        }
        if (append(list, item) < 0) {
            Py_CLEAR(list);
        }
    }
    return list;
}

/* Return a list of (name, bit, meaning) of the status. */
static PyObject *list_statuses(void)
{
    PyObject *list = PyList_New(0);
    for (int i = 0; list != NULL && i < STATUSES; ++i) {
        if (append(list, Py_BuildValue("(sIs)", statuses[i].name, statuses[i].bit, statuses[i].meaning)) < 0) {
            Py_CLEAR(list);
        }
    }
    return list;
}

/* Return the sizes [bytes] of the structs by name. */
static PyObject *list_sizes(void)
{
    PyObject *sizes = PyDict_New();
    for (int i = 0; sizes != NULL && i < STRUCTURES; ++i) {
        PyObject *const size = PyLong_FromSize_t(structures[i].size);
        if (size == NULL || PyDict_SetItemString(sizes, structures[i].name, size) < 0) {
            Py_CLEAR(sizes);
        }
        Py_XDECREF(size);
    }
    return sizes;
}

/* Add the controller's functions and tables to the module. */
int add_controller(PyObject *module)
{
    const int failed = PyModule_AddFunctions(module, controller_methods) < 0
        || PyModule_AddStringConstant(module, "NAME", ROBOT) < 0
        || PyModule_AddIntConstant(module, "MOTORS", MOTORS) < 0
        || PyModule_AddIntConstant(module, "TIPS", TIPS) < 0
        || add(module, "FIELDS", list_fields()) < 0 || add(module, "CHOICES", list_words(choices, CHOICES)) < 0
        || add(module, "OUTCOMES", list_words(outcomes, OUTCOMES)) < 0 || add(module, "STATUSES", list_statuses()) < 0
        || add(module, "SIZES", list_sizes()) < 0;
    return failed ? -1 : 0;
}
