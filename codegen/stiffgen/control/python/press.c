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
    press_config_t *const c = structs(&config, sizeof *c, 1);
    if (c != NULL) {
        CALL(press_default_config)(c);
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
    const press_config_t *const own = structs(&config, sizeof *own, 1);
    const config_t *const of_controller = structs(&controller, sizeof *of_controller, 1);
    press_state_t *const s = structs(&state, sizeof *s, 1);
    if (own != NULL && of_controller != NULL && s != NULL) {
        result = PyLong_FromLong(CALL(press_init)(own, of_controller, s));
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
    const int is_first = last.buf == NULL; /* no output of the controller yet */
    press_state_t *const s = structs(&state, sizeof *s, 1);
    const press_input_t *const in = structs(&input, sizeof *in, 1);
    const output_t *const before = is_first ? NULL : structs(&last, sizeof *before, 1);
    press_output_t *const out = structs(&output, sizeof *out, 1);
    if (s != NULL && in != NULL && (is_first || before != NULL) && out != NULL) {
        result = PyLong_FromLong(CALL(press_step)(s, in, before, out));
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
