/*
 * Lanes: LANES numbers side by side, as wide as the vectors of the machine that is compiled for, or one plain double
 * where the compiler has no vector types or computes with more bits than a double has. In single calls a lane is a
 * joint, and rows over joints are padded with zeros; in batches a lane is a configuration.
 */
#if !defined(__GNUC__) || EXCESS_PRECISION || defined(STIFFGEN_NO_VECTORS)
#define LANE_BYTES 8
#define EIGHT(a, b, c, d, e, f, g, h) a, b, c, d, e, f, g, h
typedef double lanes;
typedef unsigned long long pattern;
#else
#if defined(__AVX512F__)
#define LANE_BYTES 64
#define EIGHT(a, b, c, d, e, f, g, h) {a, b, c, d, e, f, g, h}
#define LOWER_HALVES 0, 8, 1, 9, 2, 10, 3, 11
#define UPPER_HALVES 4, 12, 5, 13, 6, 14, 7, 15
#elif defined(__AVX__)
#define LANE_BYTES 32
#define EIGHT(a, b, c, d, e, f, g, h) {a, b, c, d}, {e, f, g, h}
#define LOWER_HALVES 0, 4, 1, 5
#define UPPER_HALVES 2, 6, 3, 7
#else
#define LANE_BYTES 16
#define EIGHT(a, b, c, d, e, f, g, h) {a, b}, {c, d}, {e, f}, {g, h}
#define LOWER_HALVES 0, 2
#define UPPER_HALVES 1, 3
#endif
typedef double lanes __attribute__((vector_size(LANE_BYTES)));
typedef unsigned long long pattern __attribute__((vector_size(LANE_BYTES)));
#endif

#define LANES (LANE_BYTES / 8)

#if defined(__GNUC__)
#define ALIGNED __attribute__((aligned(64)))
#else
#define ALIGNED
#endif

/* Before a loop of few rounds, which gcc leaves a loop at -O2. */
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 8
#define UNROLLED _Pragma("GCC unroll 8")
#else
#define UNROLLED
#endif

/* Lanes as numbers, and as the bits of these. */
typedef union {
    lanes number;
    pattern bits;
} lane_bits;

/* x with the bits that a double in memory has. */
static inline double as_double(double x)
{
#if EXCESS_PRECISION
    const volatile double stored = x;
    return stored;
#else
    return x;
#endif
}
