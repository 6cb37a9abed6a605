/* Gains for Python. */
#include "controller.h"

/* Split a torque for motors: arguments (numbers, results), in the order of the C function. Return the error's code. */
static PyObject *joint_gains(PyObject *module, PyObject *arguments)
{
    enum { N = MOTORS };
    Py_buffer numbers, results;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*w*", &numbers, &results)) {
        return NULL;
    }
    const double *const q = structs(&numbers, (7 * N + 2 * N * N) * sizeof *q, 1);
    double *const tau_ff = structs(&results, 3 * N * sizeof *tau_ff, 1);
    if (q != NULL && tau_ff != NULL) { /* each argument begins where the one before it ends */
        const double *const dq = q + N, *const q_des = dq + N, *const dq_des = q_des + N, *const torque = dq_des + N;
        const double *const joint_stiffness = torque + N, *const damping = joint_stiffness + N * N;
        const double *const kp_limit = damping + N * N, *const kd_limit = kp_limit + N;
        double *const kp = tau_ff + N, *const kd = kp + N;
        result = PyLong_FromLong(CALL(joint_gains)(q, dq, q_des, dq_des, torque, joint_stiffness, damping, kp_limit,
            kd_limit, tau_ff, kp, kd));
    }
    PyBuffer_Release(&numbers);
    PyBuffer_Release(&results);
    return result;
}

/* Bound the work of motors whose host is late: arguments (numbers, hold), in the order of the C function. */
static PyObject *late_work(PyObject *module, PyObject *arguments)
{
    enum { N = MOTORS };
    Py_buffer numbers;
    double hold;
    PyObject *result = NULL;
    (void)module;
    if (!PyArg_ParseTuple(arguments, "y*d", &numbers, &hold)) {
        return NULL;
    }
    const double *const q = structs(&numbers, 7 * N * sizeof *q, 1);
    if (q != NULL) {
        const double *const q_des = q + N, *const dq_des = q_des + N, *const tau_ff = dq_des + N;
        const double *const kp = tau_ff + N, *const kd = kp + N, *const velocity_limit = kd + N;
        result = PyFloat_FromDouble(CALL(late_work)(q, q_des, dq_des, tau_ff, kp, kd, velocity_limit, hold));
    }
    PyBuffer_Release(&numbers);
    return result;
}

static PyMethodDef gains_methods[] = {
    {"joint_gains", joint_gains, METH_VARARGS, NULL},
    {"late_work", late_work, METH_VARARGS, NULL},
    {NULL, NULL, 0, NULL},
};

/* Add the functions of gains to the module. */
int add_gains(PyObject *module)
{
    return PyModule_AddFunctions(module, gains_methods);
}
