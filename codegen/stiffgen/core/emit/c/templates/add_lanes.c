#if LANE_BYTES > {{ scalar.bytes }}
/*
 * Add the lower half of each vector to its upper half; the sums of a and b alternate in the result. After log2(LANES)
 * rounds on LANES vectors, lane k of the last one is the sum of the lanes of vector k.
 */
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

/* Store the sum of the lanes of from[k] in to[k], NaN for infinity. Both arrays are padded to whole vectors. */
static inline void add_lanes(const lanes *from, int count, lanes *to)
{
    for (int k = 0; k < count; k += LANES) {
        lanes sums[LANES];
        memcpy(sums, &from[k], sizeof sums);
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
