#if LANE_BYTES > 8
/* The sums of the halves of two, alternating: applied to LANES of them in turn, the sum of each in its own place. */
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

/* to[k] = the sum of the numbers in from[k], NaN in place of infinity; from and to have room for whole lanes. */
static inline void add_lanes(const lanes *from, int count, lanes *to)
{
    for (int k = 0; k < count; k += LANES) {
        const lanes *const f = from + k;
#if LANE_BYTES == 64
        const lanes even = add_halves(add_halves(f[0], f[4]), add_halves(f[2], f[6]));
        const lanes odd = add_halves(add_halves(f[1], f[5]), add_halves(f[3], f[7]));
        *to++ = finite_lanes(add_halves(even, odd));
#elif LANE_BYTES == 32
        *to++ = finite_lanes(add_halves(add_halves(f[0], f[2]), add_halves(f[1], f[3])));
#elif LANE_BYTES == 16
        *to++ = finite_lanes(add_halves(f[0], f[1]));
#else
        *to++ = finite_lanes(f[0]);
#endif
    }
}
