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
    policy_config_t *const c = structs(&config, sizeof *c, 1);
    if (c != NULL) {
        CALL(policy_default_config)(c);
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
    policy_state_t *const s = structs(&state, sizeof *s, 1);
    const policy_config_t *const c = structs(&config, sizeof *c, 1);
    const double *const entries = structs(&poses, 16 * TIPS * sizeof *entries, 1);
    if (s != NULL && c != NULL && entries != NULL) {
        result = PyLong_FromLong(CALL(policy_start)(s, c, entries, now));
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
    policy_state_t *const s = structs(&state, sizeof *s, 1);
    const policy_proposal_t *const proposed = structs(&proposal, sizeof *proposed, 1);
    if (s != NULL && proposed != NULL) {
        result = PyLong_FromLong(CALL(policy_propose)(s, proposed, now));
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
    policy_state_t *const s = structs(&state, sizeof *s, 1);
    policy_output_t *const out = structs(&output, sizeof *out, 1);
    if (s != NULL && out != NULL) {
        result = PyLong_FromLong(CALL(policy_command)(s, now, out));
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
