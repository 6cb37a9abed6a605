/*
 * Transpose a square of LANES x LANES numbers in log2(LANES) rounds, each of which interleaves the rows k and
 * k + LANES / 2: entry c of row r, at the place (r, c) written in binary digits behind each other, goes to the place with
 * these digits rotated by one to the left. After log2(LANES) rounds it is at (c, r).
 */
static inline void transpose(lanes square[LANES])
{
#if LANE_BYTES > {{ scalar.bytes }}
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

{% if scalar.name == "float" %}
{% include "transpose_four.c" %}

{% endif %}
/*
 * Load LANES configurations, starting at number first: entry k of all of them becomes to[k]. Configurations lie step
 * numbers apart. If fewer than LANES remain, the last configuration fills the other lanes. An argument shared by all
 * configurations (step 0) is loaded once, by the first call. Inlining load_lanes and store_lanes would double the
 * compilation time without making the code faster.
 */
static APART void load_lanes(const {{ scalar.name }} *from, ptrdiff_t step, size_t first, size_t count, int size, lanes *to)
{
    if (first != 0 && step == 0) {
        return;
    }
    const {{ scalar.name }} *configuration[LANES];
    for (size_t c = 0; c < LANES; ++c) {
        configuration[c] = from + step * (ptrdiff_t)(first + c < count ? first + c : count - 1);
    }
    const int whole = size - size % LANES;
    for (int k = 0; k < whole; k += LANES) {
        for (int c = 0; c < LANES; ++c) {
            memcpy(&to[k + c], configuration[c] + k, sizeof(lanes));
        }
        transpose(to + k);
    }
{% if scalar.name == "float" %}
#if LANE_BYTES > 4
    for (int k = whole; k < size && size >= 4; k += 4) { /* the last four may overlap the four before */
        load_four(configuration, k + 4 <= size ? k : size - 4, to);
    }
    if (size >= 4) {
        return;
    }
#endif
{% endif %}
#define ENTRY(c) configuration[c][k]
    for (int k = whole; k < size; ++k) {
        const lanes entries = EACH(ENTRY);
        to[k] = entries;
    }
#undef ENTRY
}

{% if takes_symmetric_parts %}
/*
 * Replace matrices of n rows by their symmetric parts 0.5 (K + K^T), in their upper triangles alone: size numbers that
 * load_lanes has loaded. Of matrices shared by all configurations (step 0) only the first call does this.
 */
static inline void take_symmetric_parts(lanes *matrices, ptrdiff_t step, size_t first, int size, int n)
{
    if (first != 0 && step == 0) {
        return;
    }
    for (lanes *K = matrices; K < matrices + size; K += n * n) {
        for (int i = 0; i < n; ++i) {
            for (int j = i + 1; j < n; ++j) {
                K[n * i + j] = {{ scalar.constant(0.5) }} * (K[n * i + j] + K[n * j + i]);
            }
        }
    }
}

{% endif %}
/* Store from[k] as entry k of LANES configurations, or of the left ones if fewer remain. */
static APART void store_lanes(const lanes *from, size_t left, int size, {{ scalar.name }} *to)
{
    const int present = left < LANES ? (int)left : LANES;
    const int whole = size - size % LANES; /* entries in squares of LANES x LANES */
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
{% if scalar.name == "float" %}
#if LANE_BYTES > 4
    for (int k = whole; k < size && size >= 4; k += 4) {
        store_four(from, k + 4 <= size ? k : size - 4, present, size, to);
    }
    if (size >= 4) {
        return;
    }
#endif
{% endif %}
    for (int k = whole; k < size; ++k) {
        const lanes finite = finite_lanes(from[k]);
        if (size == 1 && present == LANES) {
            memcpy(to, &finite, sizeof finite);
            return;
        }
        for (int c = 0; c < present; ++c) {
            to[size * c + k] = ((const {{ scalar.name }} *)&finite)[c];
        }
    }
}

/* Pack the upper triangle of a matrix of n rows, row by row, in place. */
static APART void pack_upper(lanes *matrix, int n)
{
    int k = n; /* the first row stays */
    for (int i = 1; i < n; ++i) {
        for (int j = i; j < n; ++j) {
            matrix[k++] = matrix[n * i + j];
        }
    }
}
