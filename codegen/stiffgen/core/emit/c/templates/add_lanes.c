#if LANE_BYTES > {{ scalar.bytes }}
/* Add the lower half of each vector to its upper half; the sums of a and b alternate: a0 + a2, b0 + b2, a1 + a3, b1 + b3. */
static inline lanes add_halves(lanes a, lanes b)
{
#if defined(__clang__)
    return __builtin_shufflevector(a, b, LOWER_HALVES) + __builtin_shufflevector(a, b, UPPER_HALVES);
#else
    const pattern lower = {LOWER_HALVES}, upper = {UPPER_HALVES};
    return __builtin_shuffle(a, b, lower) + __builtin_shuffle(a, b, upper);
#endif
}
#endif

/*
 * Store as lane k of to the sum of all lanes of the vector from[k], NaN for infinity. Both arrays are padded to whole
 * vectors. A block of LANES vectors becomes one: each round pairs vector n with n + half, so that of four lanes the first
 * round leaves (v0, v2, v0, v2) and (v1, v3, v1, v3), where v0 is a part of the sum of vector 0, and the last one (v0, v1,
 * v2, v3), whole sums.
 */
static inline void add_lanes(const lanes *from, int count, lanes *to)
{
    for (int block = 0; block < count; block += LANES) {
        lanes sums[LANES];
        memcpy(sums, &from[block], sizeof sums);
#if LANE_BYTES > {{ scalar.bytes }}
        UNROLLED
        for (int half = LANES / 2; half > 0; half /= 2) {
            UNROLLED
            for (int n = 0; n < half; ++n) {
                sums[n] = add_halves(sums[n], sums[n + half]);
            }
        }
#endif
        *to++ = finite_lanes(sums[0]);
    }
}
