/* Follow for Python. */
#include "controller.h"

/* Write the default configuration: argument (config). */
static PyObject *follow_default(PyObject *module, PyObject *arguments)
{
    Py_buffer config;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*", &config)) {
        return NULL;
    }
    follow_config_t *const c = structs(&config, sizeof *c, 1);
    if (c != NULL) {
        CALL(follow_default_config)(c);
    }
    PyBuffer_Release(&config);
    return c != NULL ? Py_NewRef(Py_None) : NULL;
}

/* Begin at joint positions: arguments (config, state, q). Return the error's code. */
static PyObject *follow_init(PyObject *module, PyObject *arguments)
{
    Py_buffer config, state, q;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*w*y*", &config, &state, &q)) {
        return NULL;
    }
    const follow_config_t *const c = structs(&config, sizeof *c, 1);
    follow_state_t *const s = structs(&state, sizeof *s, 1);
    const double *const positions = structs(&q, MOTORS * sizeof *positions, 1);
    if (c != NULL && s != NULL && positions != NULL) {
        result = PyLong_FromLong(CALL(follow_init)(c, s, positions));
    }
    PyBuffer_Release(&config);
    PyBuffer_Release(&state);
    PyBuffer_Release(&q);
    return result;
}

/* Do a step per input: arguments (count, state, inputs, outputs). Return the last error. */
static PyObject *follow_step(PyObject *module, PyObject *arguments)
{
    Py_buffer state, input, output;
    Py_ssize_t count;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "nw*y*w*", &count, &state, &input, &output)) {
        return NULL;
    }
    follow_state_t *const s = structs(&state, sizeof *s, 1);
    const follow_input_t *const in = structs(&input, sizeof *in, count);
    follow_output_t *const out = structs(&output, sizeof *out, count);
    if (s != NULL && in != NULL && out != NULL) {
        int error = 0;
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t k = 0; k < count; ++k) {
            const int code = CALL(follow_step)(s, in + k, out + k);
            error = code != 0 ? code : error;
        }
        Py_END_ALLOW_THREADS
        result = PyLong_FromLong(error);
    }
    PyBuffer_Release(&state);
    PyBuffer_Release(&input);
    PyBuffer_Release(&output);
    return result;
}

/* Return an error in words: argument (code). */
static PyObject *follow_error_text(PyObject *module, PyObject *arguments)
{
    int code;
    (void)module;
    return PyArg_ParseTuple(arguments, "i", &code) ? PyUnicode_FromString(CALL(follow_error_text)(code)) : NULL;
}

static PyMethodDef follow_methods[] = {
    {"follow_default", follow_default, METH_VARARGS, NULL},
    {"follow_init", follow_init, METH_VARARGS, NULL},
    {"follow_step", follow_step, METH_VARARGS, NULL},
    {"follow_error_text", follow_error_text, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

/* Add Follow's functions to the module. */
int add_follow(PyObject *module)
{
    return PyModule_AddFunctions(module, follow_methods);
}
