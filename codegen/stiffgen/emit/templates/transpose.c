/* Transpose a square of LANES x LANES numbers: one round of pairing rows for every halving of their number. */
static inline void transpose(lanes square[LANES])
{
#if LANE_BYTES > 8
    for (int round = 1; round < LANES; round *= 2) {
        lanes paired[LANES];
        for (int k = 0; k < LANES / 2; ++k) {
            const lanes a = square[k], b = square[k + LANES / 2];
#if defined(__clang__)
            paired[2 * k] = __builtin_shufflevector(a, b, LOWER_HALVES);
            paired[2 * k + 1] = __builtin_shufflevector(a, b, UPPER_HALVES);
#else
            const pattern lower = {LOWER_HALVES}, upper = {UPPER_HALVES};
            paired[2 * k] = __builtin_shuffle(a, b, lower);
            paired[2 * k + 1] = __builtin_shuffle(a, b, upper);
#endif
        }
        for (int k = 0; k < LANES; ++k) {
            square[k] = paired[k];
        }
    }
#else
    (void)square;
#endif
}

/* Entry k of LANES configurations becomes lanes k; where fewer are left, the last one stands in. */
static inline void load_lanes(const double *from, ptrdiff_t step, size_t left, int size, lanes *to)
{
    const int present = left < LANES ? (int)left : LANES;
    const double *configuration[LANES];
    for (int c = 0; c < LANES; ++c) {
        configuration[c] = from + step * (c < present ? c : present - 1);
    }
    const int whole = size - size % LANES;
    for (int k = 0; k < whole; k += LANES) {
        for (int c = 0; c < LANES; ++c) {
            memcpy(&to[k + c], configuration[c] + k, sizeof(lanes));
        }
        transpose(to + k);
    }
    for (int k = whole; k < size; ++k) {
        for (int c = 0; c < LANES; ++c) {
            ((double *)to)[LANES * k + c] = configuration[c][k];
        }
    }
}

/* Lanes k become entry k of LANES configurations, or of those that are left. */
static inline void store_lanes(const lanes *from, size_t left, int size, double *to)
{
    const int present = left < LANES ? (int)left : LANES;
    const int whole = size - size % LANES;
    for (int k = 0; k < whole; k += LANES) {
        lanes square[LANES];
        for (int c = 0; c < LANES; ++c) {
            square[c] = finite_lanes(from[k + c]);
        }
        transpose(square);
        for (int c = 0; c < present; ++c) {
            memcpy(&to[size * c + k], &square[c], sizeof(lanes));
        }
    }
    for (int k = whole; k < size; ++k) {
        const lanes finite = finite_lanes(from[k]);
        for (int c = 0; c < present; ++c) {
            to[size * c + k] = ((const double *)&finite)[c];
        }
    }
}
