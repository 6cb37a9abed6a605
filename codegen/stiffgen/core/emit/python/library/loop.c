/* Inner loop of every ufunc: single calls, or a batch. */
#include "ufuncs.h"

/* Memory of the operands of a loop. Each is used in place, or copied without gaps into its part of one buffer. */
typedef struct {
    const npy_intp *core_steps[MAX_OPERANDS]; /* [bytes] between entries, one step per dimension of the operand */
    npy_intp size[MAX_OPERANDS];              /* numbers of the copy; 0: in place */
    number *packed[MAX_OPERANDS];             /* the copy; NULL: in place */
    number *buffer;                           /* all copies; NULL: none */
} operand_memory;

/* Find each operand's steps: NumPy's list begins with one step per operand, between configurations. */
static void find_core_steps(const kernel *k, const npy_intp *steps, operand_memory *m)
{
    const npy_intp *next = steps + k->operands;
    for (int o = 0; o < k->operands; ++o) {
        m->core_steps[o] = next;
        next += k->rank[o];
    }
}

/* Give each operand with a size its part of a new buffer. Return 0, with the error set, if there is no memory. */
static int allocate_copies(const kernel *k, operand_memory *m)
{
    npy_intp needed = 0;
    for (int o = 0; o < k->operands; ++o) {
        needed += m->size[o];
    }
    if (needed == 0) {
        return 1;
    }
    m->buffer = (number *)PyMem_RawMalloc((size_t)needed * sizeof(number));
    if (m->buffer == NULL) {
        PyGILState_STATE state = PyGILState_Ensure();
        PyErr_NoMemory();
        PyGILState_Release(state);
        return 0;
    }
    number *free_part = m->buffer;
    for (int o = 0; o < k->operands; ++o) {
        m->packed[o] = m->size[o] > 0 ? free_part : NULL;
        free_part += m->size[o];
    }
    return 1;
}

/* Copy count configurations of an operand, a step [bytes] apart, to its copy (pack = 1) or from it, if it has one. */
static void copy_configurations(const kernel *k, const operand_memory *m, int operand, char *block, npy_intp step,
    npy_intp count, int pack)
{
    if (m->packed[operand] == NULL) {
        return;
    }
    const npy_intp size = size_of(k, operand);
    for (npy_intp n = 0; n < count; ++n) {
        copy_block(k, operand, block + step * n, m->core_steps[operand], m->packed[operand] + size * n, pack);
    }
}

/* Run a batch. To bound memory, operands that are not contiguous are copied CHUNK configurations at a time. */
static void batch_loop(const kernel *k, char **args, npy_intp count, const npy_intp *steps)
{
    operand_memory m = {{NULL}, {0}, {NULL}, NULL};
    npy_intp batch_steps[MAX_OPERANDS]; /* numbers between configurations */
    find_core_steps(k, steps, &m);
    for (int o = 0; o < k->operands; ++o) {
        const int in_place = is_batch(k, o, args[o], steps[o], m.core_steps[o]);
        batch_steps[o] = in_place ? steps[o] / (npy_intp)sizeof(number) : size_of(k, o);
        m.size[o] = in_place ? 0 : CHUNK * size_of(k, o);
    }
    if (!allocate_copies(k, &m)) {
        return;
    }
    const npy_intp most = m.buffer != NULL ? CHUNK : count;
    for (npy_intp done = 0; done < count; done += most) {
        const npy_intp now = count - done < most ? count - done : most;
        number *at[MAX_OPERANDS];
        for (int o = 0; o < k->operands; ++o) {
            at[o] = m.packed[o] != NULL ? m.packed[o] : (number *)(args[o] + steps[o] * done);
        }
        for (int o = 0; o < k->inputs; ++o) {
            copy_configurations(k, &m, o, args[o] + steps[o] * done, steps[o], now, 1);
        }
        k->evaluate_batch((size_t)now, (const number *const *)at, batch_steps, at + k->inputs);
        for (int o = k->inputs; o < k->operands; ++o) {
            copy_configurations(k, &m, o, args[o] + steps[o] * done, steps[o], now, 0);
        }
    }
    PyMem_RawFree(m.buffer);
}

/* Run single calls, each on operands in place or packed. */
static void single_loop(const kernel *k, char **args, npy_intp count, const npy_intp *steps)
{
    operand_memory m = {{NULL}, {0}, {NULL}, NULL};
    find_core_steps(k, steps, &m);
    for (int o = 0; o < k->operands; ++o) {
        m.size[o] = is_direct(k, o, args[o], steps[o], m.core_steps[o]) ? 0 : size_of(k, o);
    }
    if (!allocate_copies(k, &m)) {
        return;
    }
    for (npy_intp n = 0; n < count; ++n) {
        number *at[MAX_OPERANDS];
        for (int o = 0; o < k->operands; ++o) {
            at[o] = m.packed[o] != NULL ? m.packed[o] : (number *)(args[o] + steps[o] * n);
        }
        for (int o = 0; o < k->inputs; ++o) {
            copy_configurations(k, &m, o, args[o] + steps[o] * n, steps[o], 1, 1);
        }
        k->evaluate((const number *const *)at, at + k->inputs);
        for (int o = k->inputs; o < k->operands; ++o) {
            copy_configurations(k, &m, o, args[o] + steps[o] * n, steps[o], 1, 0);
        }
    }
    PyMem_RawFree(m.buffer);
}

/* Compute `dimensions[0]` configurations: the inner loop that NumPy calls. A kernel may have batches only, or none. */
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
