/* Press for Python. */
#include "controller.h"

/* Write the default configuration: argument (config). */
static PyObject *press_default(PyObject *module, PyObject *arguments)
{
    Py_buffer config;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*", &config)) {
        return NULL;
    }
    void *c = structs(&config, sizeof(press_config_t), 1);
    if (c != NULL) {
        CALL(press_default_config)((press_config_t *)c);
    }
    PyBuffer_Release(&config);
    return c != NULL ? Py_NewRef(Py_None) : NULL;
}

/* Begin: arguments (config, the controller's config, state). Return the error's code. */
static PyObject *press_init(PyObject *module, PyObject *arguments)
{
    Py_buffer config, controller, state;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*y*w*", &config, &controller, &state)) {
        return NULL;
    }
    const void *c = structs(&config, sizeof(press_config_t), 1);
    const void *k = c != NULL ? structs(&controller, sizeof(config_t), 1) : NULL;
    void *s = k != NULL ? structs(&state, sizeof(press_state_t), 1) : NULL;
    if (s != NULL) {
        result = PyLong_FromLong(
            CALL(press_init)((const press_config_t *)c, (const config_t *)k, (press_state_t *)s));
    }
    PyBuffer_Release(&config);
    PyBuffer_Release(&controller);
    PyBuffer_Release(&state);
    return result;
}

/* Do a step: arguments (state, input, the controller's output or None, output). Return the error's code. */
static PyObject *press_step(PyObject *module, PyObject *arguments)
{
    Py_buffer state, input, last, output;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*y*z*w*", &state, &input, &last, &output)) {
        return NULL;
    }
    void *s = structs(&state, sizeof(press_state_t), 1);
    const void *in = s != NULL ? structs(&input, sizeof(press_input_t), 1) : NULL;
    const void *before = in != NULL && last.buf != NULL ? structs(&last, sizeof(output_t), 1) : NULL;
    const int good = in != NULL && (before != NULL || last.buf == NULL);
    void *out = good ? structs(&output, sizeof(press_output_t), 1) : NULL;
    if (out != NULL) {
        result = PyLong_FromLong(CALL(press_step)(
            (press_state_t *)s, (const press_input_t *)in, (const output_t *)before, (press_output_t *)out));
    }
    PyBuffer_Release(&state);
    PyBuffer_Release(&input);
    PyBuffer_Release(&last);
    PyBuffer_Release(&output);
    return result;
}

/* Return an error in words: argument (code). */
static PyObject *press_error_text(PyObject *module, PyObject *arguments)
{
    int code;
    (void)module;
    return PyArg_ParseTuple(arguments, "i", &code) ? PyUnicode_FromString(CALL(press_error_text)(code)) : NULL;
}

static PyMethodDef press_methods[] = {
    {"press_default", press_default, METH_VARARGS, NULL},
    {"press_init", press_init, METH_VARARGS, NULL},
    {"press_step", press_step, METH_VARARGS, NULL},
    {"press_error_text", press_error_text, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

/* Add Press's functions to the module. */
int add_press(PyObject *module)
{
    return PyModule_AddFunctions(module, press_methods);
}
