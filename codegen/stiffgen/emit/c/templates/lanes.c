{% set letters = "abcdefghijklmnop"[:scalar.widest] | list %}
/*
 * Lanes: LANES numbers side by side, as wide as the vectors of the machine that is compiled for, or one plain {{ scalar.name }}
 * where the compiler has no vector types or computes with more bits than a {{ scalar.name }} has. In single calls a lane is a
 * joint, and rows over joints are padded with zeros; in batches a lane is a configuration.
 */
#if !defined(__GNUC__) || EXCESS_PRECISION || defined(STIFFGEN_NO_VECTORS)
#define LANE_BYTES {{ scalar.bytes }}
#define {{ scalar.group }}({{ letters | join(", ") }}) {{ letters | join(", ") }}
#define EACH(of) {of(0)}
typedef {{ scalar.name }} lanes;
typedef {{ scalar.pattern }} pattern;
#else
{% for bytes, known in ((64, "#if defined(__AVX512F__)"), (32, "#elif defined(__AVX__)"), (16, "#else")) %}
{% set count = bytes // scalar.bytes %}
{{ known }}
#define LANE_BYTES {{ bytes }}
#define {{ scalar.group }}({{ letters | join(", ") }}) {% for lane in letters | batch(count) %}{ {{- lane | join(", ") -}} }{{ ", " if not loop.last }}{% endfor %}

#define EACH(of) { {%- for k in range(count) %}of({{ k }}){{ ", " if not loop.last }}{% endfor -%} }
#define LOWER_HALVES {% for k in range(count // 2) %}{{ k }}, {{ k + count }}{{ ", " if not loop.last }}{% endfor %}

#define UPPER_HALVES {% for k in range(count // 2, count) %}{{ k }}, {{ k + count }}{{ ", " if not loop.last }}{% endfor %}

{% endfor %}
#endif
typedef {{ scalar.name }} lanes __attribute__((vector_size(LANE_BYTES)));
typedef {{ scalar.pattern }} pattern __attribute__((vector_size(LANE_BYTES)));
#endif

#define LANES (LANE_BYTES / {{ scalar.bytes }})

/* Of a comparison of lanes the bits: all of a lane, or none. */
#if LANE_BYTES > {{ scalar.bytes }}
#define MASK(comparison) ((pattern)(comparison))
#else
#define MASK(comparison) (0 - (pattern)(comparison))
#endif

#if defined(__GNUC__)
#define ALIGNED __attribute__((aligned(64)))
#define APART __attribute__((noinline))
#else
#define ALIGNED
#define APART
#endif

/* Before a loop of few rounds, which gcc leaves a loop at -O2. */
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 8
#define UNROLLED _Pragma("GCC unroll 8")
#define ROLLED _Pragma("GCC unroll 1") /* before one that it is to leave: no slower, and compiled faster */
#else
#define UNROLLED
#define ROLLED
#endif

/* Lanes as numbers, and as the bits of these. */
typedef union {
    lanes number;
    pattern bits;
} lane_bits;

/* x with the bits that a {{ scalar.name }} in memory has. */
static inline {{ scalar.name }} as_{{ scalar.name }}({{ scalar.name }} x)
{
#if EXCESS_PRECISION
    const volatile {{ scalar.name }} stored = x;
    return stored;
#else
    return x;
#endif
}
