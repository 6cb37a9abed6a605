/* Likely mistakes in inputs: degrees and asymmetric matrices. */
#include "ufuncs.h"

/* Inputs are checked in the first ALL_CALLS calls and every SOME_CALLS-th call, since a check takes some 40 ns. */
enum { DEGREES = 1, ASYMMETRIC = 2, MOST_CHECKED = 4, ALL_CALLS = 256, SOME_CALLS = 32 };
static volatile unsigned calls;
static volatile int suspicious; /* set without the GIL; the calling thread warns, once for each bit */
static int warned;

static number value_at(const char *at)
{
    number value;
    memcpy(&value, at, sizeof value);
    return value;
}

/* Return whether a position is so far beyond its limits that it may be in degrees. */
static int is_beyond_a_turn(const char *q, const npy_intp *steps)
{
    int beyond = 0;
    for (npy_intp i = 0; i < POSITIONS; ++i) {
        const number value = value_at(q + i * steps[0]);
        beyond |= value > turn_limits[i] || value < -turn_limits[i];
    }
    return beyond;
}

static number magnitude(number value)
{
    return value < 0 ? -value : value;
}

static number larger(number a, number b)
{
    return a > b ? a : b;
}

/* Compare the triangles of a matrix, or of the first of several, with a tolerance for rounding. */
static int is_asymmetric(const kernel *k, int operand, const char *matrix, const npy_intp *steps)
{
    const int last = k->rank[operand] - 1;
    const npy_intp size = k->extent[operand][last], row = steps[last - 1], column = steps[last];
    number scale = 0, largest = 0;
    for (npy_intp i = 0; i < size; ++i) {
        for (npy_intp j = i; j < size; ++j) {
            const number upper = value_at(matrix + i * row + j * column);
            const number lower = value_at(matrix + j * row + i * column);
            scale = larger(scale, larger(magnitude(upper), magnitude(lower)));
            largest = larger(largest, magnitude(upper - lower));
        }
    }
    return largest > ASYMMETRY * scale;
}

/* Look for degrees and asymmetric matrices in at most MOST_CHECKED configurations of a call. */
static void look_at_each(const kernel *k, char **args, npy_intp count, const npy_intp *steps)
{
    const npy_intp *core_steps = steps + k->operands;
    const npy_intp stride = count > MOST_CHECKED ? (count - 1) / (MOST_CHECKED - 1) : 1;
    for (int o = 0; o < k->inputs; core_steps += k->rank[o], ++o) {
        for (npy_intp n = 0; n < count && k->check[o] != '-' && (n == 0 || steps[o] != 0); n += stride) {
            const char *const block = args[o] + n * steps[o];
            if (k->check[o] == 'q' ? is_beyond_a_turn(block, core_steps) : is_asymmetric(k, o, block, core_steps)) {
                suspicious |= k->check[o] == 'q' ? DEGREES : ASYMMETRIC;
            }
        }
    }
}

/* Look at the inputs of some calls. */
void look_at_inputs(const kernel *k, char **args, npy_intp count, const npy_intp *steps)
{
    const unsigned call_number = calls++;
    if (call_number < ALL_CALLS || call_number % SOME_CALLS == 0) {
        look_at_each(k, args, count, steps);
    }
}

/* Warn of a suspicious input, once per process; return -1 if the warning is an exception. */
static int warn(int bit, const char *message)
{
    if ((suspicious & bit & ~warned) == 0) {
        return 0;
    }
    warned |= bit;
    return PyErr_WarnEx(PyExc_UserWarning, message, 1);
}

/* Warn once about each likely mistake that was seen. Return -1 where a warning is an error. */
int warn_of_inputs(void)
{
    if ((suspicious & ~warned) == 0) {
        return 0;
    }
    if (warn(DEGREES, ROBOT ": a joint position is beyond 2 pi, and the joint's limits are below: are the positions in "
            "degrees? Functions take radians") < 0) {
        return -1;
    }
    return warn(ASYMMETRIC, ROBOT ": " ASYMMETRIC_TEXT);
}
