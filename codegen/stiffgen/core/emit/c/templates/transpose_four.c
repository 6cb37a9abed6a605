#if LANE_BYTES > 4
/* 4 x 4 squares, for remainders shorter than LANES. */
typedef float four __attribute__((vector_size(16)));

/*
 * Transpose a square of 4 x 4 floats in two rounds, each of which interleaves the rows k and k + 2: of the rows a, b, c, d
 * the first makes a0 c0 a1 c1, a2 c2 a3 c3, b0 d0 b1 d1, b2 d2 b3 d3, the second a0 b0 c0 d0 and so on.
 */
static inline void transpose_four(four square[4])
{
    for (int round = 0; round < 2; ++round) {
        four paired[4]; /* 0 to 3 are the entries of row k, 4 to 7 those of row k + 2 */
        for (int k = 0; k < 2; ++k) {
#if defined(__clang__)
            paired[2 * k] = __builtin_shufflevector(square[k], square[k + 2], 0, 4, 1, 5);
            paired[2 * k + 1] = __builtin_shufflevector(square[k], square[k + 2], 2, 6, 3, 7);
#else
            typedef unsigned order __attribute__((vector_size(16)));
            const order lower = {0, 4, 1, 5}, upper = {2, 6, 3, 7};
            paired[2 * k] = __builtin_shuffle(square[k], square[k + 2], lower);
            paired[2 * k + 1] = __builtin_shuffle(square[k], square[k + 2], upper);
#endif
        }
        for (int k = 0; k < 4; ++k) {
            square[k] = paired[k];
        }
    }
}

/* Load entries first to first + 3 of LANES configurations. */
static inline void load_four(const float *const configuration[LANES], int first, lanes *to)
{
    for (int c = 0; c < LANES; c += 4) {
        four square[4];
        for (int k = 0; k < 4; ++k) {
            memcpy(&square[k], configuration[c + k] + first, sizeof(four));
        }
        transpose_four(square);
        for (int k = 0; k < 4; ++k) {
            memcpy((float *)&to[first + k] + c, &square[k], sizeof(four));
        }
    }
}

/* Store entries first to first + 3 of the configurations present. */
static inline void store_four(const lanes *from, int first, int present, int size, float *to)
{
    lanes finite[4];
    for (int k = 0; k < 4; ++k) {
        finite[k] = finite_lanes(from[first + k]);
    }
    for (int c = 0; c < present; c += 4) {
        four square[4];
        for (int k = 0; k < 4; ++k) {
            memcpy(&square[k], (const float *)&finite[k] + c, sizeof(four)); /* row k: four configurations */
        }
        transpose_four(square);
        for (int k = 0; k < 4 && c + k < present; ++k) {
            memcpy(to + size * (c + k) + first, &square[k], sizeof(four));
        }
    }
}
#endif
