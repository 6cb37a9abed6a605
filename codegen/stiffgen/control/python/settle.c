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
    void *c = structs(&config, sizeof(settle_config_t), 1);
    if (c != NULL) {
        CALL(settle_default_config)((settle_config_t *)c);
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
    const void *c = structs(&config, sizeof(settle_config_t), 1);
    const void *k = c != NULL ? structs(&controller, sizeof(config_t), 1) : NULL;
    void *s = k != NULL ? structs(&state, sizeof(settle_state_t), 1) : NULL;
    if (s != NULL) {
        result = PyLong_FromLong(
            CALL(settle_init)((const settle_config_t *)c, (const config_t *)k, (settle_state_t *)s));
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
    void *s = structs(&state, sizeof(settle_state_t), 1);
    const void *in = s != NULL ? structs(&input, sizeof(settle_input_t), 1) : NULL;
    const void *before = in != NULL && last.buf != NULL ? structs(&last, sizeof(output_t), 1) : NULL;
    const int good = in != NULL && (before != NULL || last.buf == NULL);
    void *out = good ? structs(&output, sizeof(settle_output_t), 1) : NULL;
    if (out != NULL) {
        result = PyLong_FromLong(CALL(settle_step)(
            (settle_state_t *)s, (const settle_input_t *)in, (const output_t *)before, (settle_output_t *)out));
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
