/* Settle for Python. */
#include "controller.h"

/* Write the default configuration: argument (config). */
static PyObject *settle_default(PyObject *module, PyObject *arguments)
{
    Py_buffer config;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*", &config)) {
        return NULL;
    }
    settle_config_t *const c = structs(&config, sizeof *c, 1);
    if (c != NULL) {
        CALL(settle_default_config)(c);
    }
    PyBuffer_Release(&config);
    return c != NULL ? Py_NewRef(Py_None) : NULL;
}

/* Begin: arguments (config, the controller's config, state). Return the error's code. */
static PyObject *settle_init(PyObject *module, PyObject *arguments)
{
    Py_buffer config, controller, state;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*y*w*", &config, &controller, &state)) {
        return NULL;
    }
    const settle_config_t *const own = structs(&config, sizeof *own, 1);
    const config_t *const of_controller = structs(&controller, sizeof *of_controller, 1);
    settle_state_t *const s = structs(&state, sizeof *s, 1);
    if (own != NULL && of_controller != NULL && s != NULL) {
        result = PyLong_FromLong(CALL(settle_init)(own, of_controller, s));
    }
    PyBuffer_Release(&config);
    PyBuffer_Release(&controller);
    PyBuffer_Release(&state);
    return result;
}

/* Do a step: arguments (state, input, the controller's output or None, output). Return the error's code. */
static PyObject *settle_step(PyObject *module, PyObject *arguments)
{
    Py_buffer state, input, last, output;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*y*z*w*", &state, &input, &last, &output)) {
        return NULL;
    }
    const int is_first = last.buf == NULL; /* no output of the controller yet */
    settle_state_t *const s = structs(&state, sizeof *s, 1);
    const settle_input_t *const in = structs(&input, sizeof *in, 1);
    const output_t *const before = is_first ? NULL : structs(&last, sizeof *before, 1);
    settle_output_t *const out = structs(&output, sizeof *out, 1);
    if (s != NULL && in != NULL && (is_first || before != NULL) && out != NULL) {
        result = PyLong_FromLong(CALL(settle_step)(s, in, before, out));
    }
    PyBuffer_Release(&state);
    PyBuffer_Release(&input);
    PyBuffer_Release(&last);
    PyBuffer_Release(&output);
    return result;
}

/* Return an error in words: argument (code). */
static PyObject *settle_error_text(PyObject *module, PyObject *arguments)
{
    int code;
    (void)module;
    return PyArg_ParseTuple(arguments, "i", &code) ? PyUnicode_FromString(CALL(settle_error_text)(code)) : NULL;
}

static PyMethodDef settle_methods[] = {
    {"settle_default", settle_default, METH_VARARGS, NULL},
    {"settle_init", settle_init, METH_VARARGS, NULL},
    {"settle_step", settle_step, METH_VARARGS, NULL},
    {"settle_error_text", settle_error_text, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

/* Add Settle's functions to the module. */
int add_settle(PyObject *module)
{
    return PyModule_AddFunctions(module, settle_methods);
}
