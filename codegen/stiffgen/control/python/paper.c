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
    void *c = structs(&config, sizeof(paper_config_t), 1);
    if (c != NULL) {
        CALL(paper_default_config)((paper_config_t *)c);
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
    const void *c = structs(&config, sizeof(paper_config_t), 1);
    if (c != NULL) {
        result = PyLong_FromLong(CALL(paper_validate)((const paper_config_t *)c));
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
    const void *c = structs(&config, sizeof(paper_config_t), 1);
    void *s = c != NULL ? structs(&state, sizeof(paper_state_t), 1) : NULL;
    const void *in = s != NULL ? structs(&input, sizeof(paper_input_t), 1) : NULL;
    void *out = in != NULL ? structs(&output, sizeof(paper_output_t), 1) : NULL;
    if (out != NULL) {
        result = PyLong_FromLong(CALL(paper_step)((const paper_config_t *)c, (paper_state_t *)s,
            (const paper_input_t *)in, (paper_output_t *)out));
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
