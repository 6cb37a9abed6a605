/* Memory of operands: sizes, use in place, copies. */
#include "ufuncs.h"

/* Return the numbers of an operand in one configuration. */
npy_intp size_of(const kernel *k, int operand)
{
    npy_intp size = 1;
    for (int d = 0; d < k->rank[operand]; ++d) {
        size *= k->extent[operand][d];
    }
    return size;
}

/* Check whether the C function can use an operand's memory in place: aligned and without gaps. */
int is_direct(const kernel *k, int operand, const char *block, npy_intp outer, const npy_intp *steps)
{
    npy_intp expected = (npy_intp)sizeof(number);
    for (int d = k->rank[operand] - 1; d >= 0; --d) {
        if (k->extent[operand][d] != 1 && steps[d] != expected) {
            return 0;
        }
        expected *= k->extent[operand][d];
    }
    return (npy_uintp)block % sizeof(number) == 0 && outer % (npy_intp)sizeof(number) == 0;
}

/* Check whether the batch function can use an operand's memory in place; results must also be contiguous. */
int is_batch(const kernel *k, int operand, const char *block, npy_intp outer, const npy_intp *steps)
{
    return is_direct(k, operand, block, outer, steps)
        && (operand < k->inputs || outer == size_of(k, operand) * (npy_intp)sizeof(number));
}

/* Copy one configuration of a strided operand into (pack = 1) or out of a packed buffer. */
void copy_block(const kernel *k, int operand, char *block, const npy_intp *steps, number *packed, int pack)
{
    const npy_intp *extent = k->extent[operand];
    const int rank = k->rank[operand];
    const npy_intp rows = rank > 1 ? extent[rank - 2] : 1;
    const npy_intp planes = rank > 2 ? extent[0] : 1;
    const npy_intp columns = rank > 0 ? extent[rank - 1] : 1;
    for (npy_intp a = 0; a < planes; ++a) {
        for (npy_intp b = 0; b < rows; ++b) {
            for (npy_intp c = 0; c < columns; ++c) {
                char *at = block; /* steps are in bytes */
                at += rank > 0 ? c * steps[rank - 1] : 0;
                at += rank > 1 ? b * steps[rank - 2] : 0;
                at += rank > 2 ? a * steps[0] : 0;
                if (pack) {
                    memcpy(packed++, at, sizeof(number));
                } else {
                    memcpy(at, packed++, sizeof(number));
                }
            }
        }
    }
}
