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
    void *c = structs(&config, sizeof(follow_config_t), 1);
    if (c != NULL) {
        CALL(follow_default_config)((follow_config_t *)c);
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
    const void *c = structs(&config, sizeof(follow_config_t), 1);
    void *s = c != NULL ? structs(&state, sizeof(follow_state_t), 1) : NULL;
    const void *x = s != NULL ? structs(&q, MOTORS * sizeof(double), 1) : NULL;
    if (x != NULL) {
        result = PyLong_FromLong(CALL(follow_init)((const follow_config_t *)c, (follow_state_t *)s, (const double *)x));
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
    void *s = structs(&state, sizeof(follow_state_t), 1);
    const follow_input_t *in = s != NULL ? structs(&input, sizeof(follow_input_t), count) : NULL;
    follow_output_t *out = in != NULL ? structs(&output, sizeof(follow_output_t), count) : NULL;
    if (out != NULL) {
        int error = 0;
        Py_BEGIN_ALLOW_THREADS
        for (Py_ssize_t k = 0; k < count; ++k) {
            const int code = CALL(follow_step)((follow_state_t *)s, in + k, out + k);
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
