/* Law of the paper for Python. */
#include "controller.h"

/* Write the paper's default configuration: argument (config). */
static PyObject *paper_default(PyObject *module, PyObject *arguments)
{
    Py_buffer config;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*", &config)) {
        return NULL;
    }
    paper_config_t *const c = structs(&config, sizeof *c, 1);
    if (c != NULL) {
        CALL(paper_default_config)(c);
    }
    PyBuffer_Release(&config);
    return c != NULL ? Py_NewRef(Py_None) : NULL;
}

/* Check a configuration of the paper's law: argument (config). */
static PyObject *paper_validate(PyObject *module, PyObject *arguments)
{
    Py_buffer config;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*", &config)) {
        return NULL;
    }
    const paper_config_t *const c = structs(&config, sizeof *c, 1);
    if (c != NULL) {
        result = PyLong_FromLong(CALL(paper_validate)(c));
    }
    PyBuffer_Release(&config);
    return result;
}

/* Do one step of the paper's law: arguments (config, state, input, output). */
static PyObject *paper_step(PyObject *module, PyObject *arguments)
{
    Py_buffer config, state, input, output;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*w*y*w*", &config, &state, &input, &output)) {
        return NULL;
    }
    const paper_config_t *const c = structs(&config, sizeof *c, 1);
    paper_state_t *const s = structs(&state, sizeof *s, 1);
    const paper_input_t *const in = structs(&input, sizeof *in, 1);
    paper_output_t *const out = structs(&output, sizeof *out, 1);
    if (c != NULL && s != NULL && in != NULL && out != NULL) {
        result = PyLong_FromLong(CALL(paper_step)(c, s, in, out));
    }
    PyBuffer_Release(&config);
    PyBuffer_Release(&state);
    PyBuffer_Release(&input);
    PyBuffer_Release(&output);
    return result;
}

static PyMethodDef paper_methods[] = {
    {"paper_default", paper_default, METH_VARARGS, NULL},
    {"paper_validate", paper_validate, METH_VARARGS, NULL},
    {"paper_step", paper_step, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

/* Add the functions of the paper's law to the module. */
int add_paper(PyObject *module)
{
    return PyModule_AddFunctions(module, paper_methods);
}
