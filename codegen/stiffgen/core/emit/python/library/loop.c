/* Inner loop of every ufunc: single calls, or a batch. */
#include "ufuncs.h"

/* Give each operand with a size a part of one buffer, which has room for all. Return NULL without memory. */
static number *share_buffer(int operands, const npy_intp *sizes, npy_intp needed, number **packed)
{
    number *const buffer = (number *)PyMem_RawMalloc((size_t)needed * sizeof(number));
    if (buffer == NULL) {
        PyGILState_STATE state = PyGILState_Ensure();
        PyErr_NoMemory();
        PyGILState_Release(state);
        return NULL;
    }
    number *free_part = buffer;
    for (int o = 0; o < operands; ++o) {
        packed[o] = sizes[o] > 0 ? free_part : NULL;
        free_part += sizes[o];
    }
    return buffer;
}

/* Run a batch. To bound memory, operands that are not contiguous are copied CHUNK configurations at a time. */
static void batch_loop(const kernel *k, char **args, npy_intp count, const npy_intp *steps)
{
    const npy_intp *core_steps[MAX_OPERANDS];
    npy_intp batch_steps[MAX_OPERANDS];
    number *packed[MAX_OPERANDS] = {NULL};
    number *buffer = NULL;
    npy_intp sizes[MAX_OPERANDS], needed = 0; /* numbers of the copies */

    const npy_intp *next = steps + k->operands;
    for (int o = 0; o < k->operands; ++o) {
        core_steps[o] = next;
        next += k->rank[o];
        const int in_place = is_batch(k, o, args[o], steps[o], core_steps[o]);
        batch_steps[o] = in_place ? steps[o] / (npy_intp)sizeof(number) : size_of(k, o);
        sizes[o] = in_place ? 0 : CHUNK * size_of(k, o);
        needed += sizes[o];
    }
    if (needed > 0) {
        buffer = share_buffer(k->operands, sizes, needed, packed);
        if (buffer == NULL) {
            return;
        }
    }
    const npy_intp most = needed > 0 ? CHUNK : count;
    for (npy_intp done = 0; done < count; done += most) {
        const npy_intp now = count - done < most ? count - done : most;
        number *at[MAX_OPERANDS];
        for (int o = 0; o < k->operands; ++o) {
            for (npy_intp n = 0; o < k->inputs && packed[o] != NULL && n < now; ++n) {
                copy_block(k, o, args[o] + steps[o] * (done + n), core_steps[o], packed[o] + batch_steps[o] * n, 1);
            }
            at[o] = packed[o] != NULL ? packed[o] : (number *)(args[o] + steps[o] * done);
        }
        k->evaluate_batch((size_t)now, (const number *const *)at, batch_steps, at + k->inputs);
        for (int o = k->inputs; o < k->operands; ++o) {
            for (npy_intp n = 0; packed[o] != NULL && n < now; ++n) {
                copy_block(k, o, args[o] + steps[o] * (done + n), core_steps[o], packed[o] + batch_steps[o] * n, 0);
            }
        }
    }
    PyMem_RawFree(buffer);
}

/* Run single calls, each on operands in place or packed. */
static void single_loop(const kernel *k, char **args, npy_intp count, const npy_intp *steps)
{
    const int operands = k->operands;
    const npy_intp *core_steps[MAX_OPERANDS];
    number *at[MAX_OPERANDS];
    number *packed[MAX_OPERANDS] = {NULL};
    char *block[MAX_OPERANDS];
    number *buffer = NULL;
    npy_intp sizes[MAX_OPERANDS], needed = 0; /* numbers of the copies */

    const npy_intp *next = steps + operands;
    for (int o = 0; o < operands; ++o) {
        core_steps[o] = next;
        next += k->rank[o];
        block[o] = args[o];
        sizes[o] = is_direct(k, o, args[o], steps[o], core_steps[o]) ? 0 : size_of(k, o);
        needed += sizes[o];
    }
    if (needed > 0) {
        buffer = share_buffer(operands, sizes, needed, packed);
        if (buffer == NULL) {
            return;
        }
    }
    for (npy_intp n = 0; n < count; ++n) {
        for (int o = 0; o < operands; ++o) {
            if (o < k->inputs && packed[o] != NULL) {
                copy_block(k, o, block[o], core_steps[o], packed[o], 1);
            }
            at[o] = packed[o] != NULL ? packed[o] : (number *)block[o];
        }
        k->evaluate((const number *const *)at, at + k->inputs);
        for (int o = k->inputs; o < operands; ++o) {
            if (packed[o] != NULL) {
                copy_block(k, o, block[o], core_steps[o], packed[o], 0);
            }
        }
        for (int o = 0; o < operands; ++o) {
            block[o] += steps[o];
        }
    }
    PyMem_RawFree(buffer);
}

/* Compute `dimensions[0]` configurations: the inner loop that NumPy calls. */
void loop(char **args, const npy_intp *dimensions, const npy_intp *steps, void *data)
{
    const kernel *const k = (const kernel *)data;
    const npy_intp count = dimensions[0];
    look_at_inputs(k, args, count, steps);
    if (k->evaluate == NULL || (count > 1 && k->evaluate_batch != NULL)) {
        batch_loop(k, args, count, steps);
    } else {
        single_loop(k, args, count, steps);
    }
}
