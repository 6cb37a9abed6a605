/* Memory that is overwritten is seen: a checksum over all of it, and three copies of what brings the torque to zero. */
#include "impedance.h"

/* Rotate the bits of a sum, and add word k of the memory: two values of the word never have the same result. */
static uint64_t add_word(uint64_t sum, const memory_t *memory, size_t k)
{
    uint64_t word;
    memcpy(&word, (const char *)memory + k * sizeof word, sizeof word);
    return ((sum << 23) | (sum >> 41)) + word;
}

/* Compute the checksum of the memory; any single changed word changes it. */
uint64_t compute_checksum(const state_t *state)
{
    const memory_t *const m = &state->memory;
    const size_t count = sizeof *m / sizeof(uint64_t), whole = count - count % 4;
    uint64_t a = 0x9e3779b97f4a7c15u, b = 0xc2b2ae3d27d4eb4fu, c = 0x165667b19e3779f9u, d = 0x27d4eb2f165667c5u;
    for (size_t k = 0; k < whole; k += 4) { /* four sums: the processor adds to all at once */
        a = add_word(a, m, k);
        b = add_word(b, m, k + 1);
        c = add_word(c, m, k + 2);
        d = add_word(d, m, k + 3);
    }
    for (size_t k = whole; k < count; ++k) {
        a = add_word(a, m, k);
    }
    return a + 3u * b + 5u * c + 7u * d;
}

/* Masks of the copies: memory that was never initialised, or overwritten by a pattern, has no two copies that agree. */
static const uint64_t MASKS[3] = {0x9e3779b97f4a7c15u, 0xc2b2ae3d27d4eb4fu, 0x165667b19e3779f9u};

/*
 * Read numbers of three copies each; two that agree decide. Return whether all were stored by store_copies and are
 * finite; those that were not become 0.
 */
int vote(const uint64_t *copies, double *result)
{
    int all = 1;
    for (int i = 0; i < N; ++i) {
        const uint64_t a = copies[i] ^ MASKS[0], b = copies[N + i] ^ MASKS[1], c = copies[2 * N + i] ^ MASKS[2];
        const uint64_t agreed = a == b ? a : c;
        memcpy(result + i, &agreed, sizeof agreed);
        if ((a != b && b != c && a != c) || !(fabs(result[i]) <= DBL_MAX)) {
            result[i] = 0.0;
            all = 0;
        }
    }
    return all;
}

/* Store numbers in three copies, each under its own mask. */
void store_copies(uint64_t *copies, const double *values)
{
    for (int i = 0; i < N; ++i) {
        uint64_t word;
        memcpy(&word, values + i, sizeof word);
        copies[i] = word ^ MASKS[0];
        copies[N + i] = word ^ MASKS[1];
        copies[2 * N + i] = word ^ MASKS[2];
    }
}

/* Return whether the memory is what the last call left: mark, checksum, and every integer in its range. */
int is_believable(const state_t *state)
{
    const memory_t *const m = &state->memory;
    return m->ready == READY && fits_memory(m) && state->checksum == compute_checksum(state);
}
