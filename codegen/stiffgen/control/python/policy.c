/* Policy for Python. */
#include "controller.h"

/* Write the default configuration: argument (config). */
static PyObject *policy_default(PyObject *module, PyObject *arguments)
{
    Py_buffer config;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*", &config)) {
        return NULL;
    }
    void *c = structs(&config, sizeof(policy_config_t), 1);
    if (c != NULL) {
        CALL(policy_default_config)((policy_config_t *)c);
    }
    PyBuffer_Release(&config);
    return c != NULL ? Py_NewRef(Py_None) : NULL;
}

/* Start at poses: arguments (state, config, poses, now). Return the error's code. */
static PyObject *policy_start(PyObject *module, PyObject *arguments)
{
    Py_buffer state, config, poses;
    double now;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*y*y*d", &state, &config, &poses, &now)) {
        return NULL;
    }
    void *s = structs(&state, sizeof(policy_state_t), 1);
    const void *c = s != NULL ? structs(&config, sizeof(policy_config_t), 1) : NULL;
    const void *x = c != NULL ? structs(&poses, sizeof(((policy_output_t *)NULL)->pose), 1) : NULL;
    if (x != NULL) {
        result = PyLong_FromLong(
            CALL(policy_start)((policy_state_t *)s, (const policy_config_t *)c, (const double *)x, now));
    }
    PyBuffer_Release(&state);
    PyBuffer_Release(&config);
    PyBuffer_Release(&poses);
    return result;
}

/* Hand over a proposal: arguments (state, proposal, now). Return the number of refused parts, or an error. */
static PyObject *policy_propose(PyObject *module, PyObject *arguments)
{
    Py_buffer state, proposal;
    double now;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*y*d", &state, &proposal, &now)) {
        return NULL;
    }
    void *s = structs(&state, sizeof(policy_state_t), 1);
    const void *p = s != NULL ? structs(&proposal, sizeof(policy_proposal_t), 1) : NULL;
    if (p != NULL) {
        result = PyLong_FromLong(CALL(policy_propose)((policy_state_t *)s, (const policy_proposal_t *)p, now));
    }
    PyBuffer_Release(&state);
    PyBuffer_Release(&proposal);
    return result;
}

/* Write the command of a time: arguments (state, now, output). Return the error's code. */
static PyObject *policy_command(PyObject *module, PyObject *arguments)
{
    Py_buffer state, output;
    double now;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "w*dw*", &state, &now, &output)) {
        return NULL;
    }
    void *s = structs(&state, sizeof(policy_state_t), 1);
    void *out = s != NULL ? structs(&output, sizeof(policy_output_t), 1) : NULL;
    if (out != NULL) {
        result = PyLong_FromLong(CALL(policy_command)((policy_state_t *)s, now, (policy_output_t *)out));
    }
    PyBuffer_Release(&state);
    PyBuffer_Release(&output);
    return result;
}

/* Return in words why a part is refused, or an error: argument (code). */
static PyObject *policy_refused_text(PyObject *module, PyObject *arguments)
{
    int code;
    (void)module;
    return PyArg_ParseTuple(arguments, "i", &code) ? PyUnicode_FromString(CALL(policy_refused_text)(code)) : NULL;
}

static PyObject *policy_error_text(PyObject *module, PyObject *arguments)
{
    int code;
    (void)module;
    return PyArg_ParseTuple(arguments, "i", &code) ? PyUnicode_FromString(CALL(policy_error_text)(code)) : NULL;
}

static PyMethodDef policy_methods[] = {
    {"policy_default", policy_default, METH_VARARGS, NULL},
    {"policy_start", policy_start, METH_VARARGS, NULL},
    {"policy_propose", policy_propose, METH_VARARGS, NULL},
    {"policy_command", policy_command, METH_VARARGS, NULL},
    {"policy_refused_text", policy_refused_text, METH_VARARGS, NULL},
    {"policy_error_text", policy_error_text, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

/* Add the policy port's functions to the module. */
int add_policy(PyObject *module)
{
    return PyModule_AddFunctions(module, policy_methods);
}
