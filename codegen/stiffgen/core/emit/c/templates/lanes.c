{% set letters = "abcdefghijklmnop"[:scalar.widest] | list %}
/*
 * A variable of type `lanes` is one vector of LANES numbers, as wide as the processor's vector registers. `lanes` is a
 * plain {{ scalar.name }} where the compiler has no vector types or computes with more bits than a {{ scalar.name }} has. In single calls
 * each lane belongs to a joint, and rows over joints are padded with zeros. In batches each lane belongs to a
 * configuration. Single calls (SINGLE_CALLS) use at most 256 bits: 512, of which fewer are executed at a time, take longer.
 */
#if !defined(__GNUC__) || EXCESS_PRECISION || defined(STIFFGEN_NO_VECTORS)
#define LANE_BYTES {{ scalar.bytes }}
#define {{ scalar.group }}({{ letters | join(", ") }}) {{ letters | join(", ") }}
#define EACH(of) {of(0)}
typedef {{ scalar.name }} lanes;
typedef {{ scalar.pattern }} pattern;
#else
{% for bytes, known in ((64, "#if defined(__AVX512F__) && !defined(SINGLE_CALLS)"), (32, "#elif defined(__AVX__)"), (16, "#else")) %}
{% set count = bytes // scalar.bytes %}
{{ known }}
#define LANE_BYTES {{ bytes }}
#define {{ scalar.group }}({{ letters | join(", ") }}) {% for lane in letters | batch(count) %}{ {{- lane | join(", ") -}} }{{ ", " if not loop.last }}{% endfor %}

#define EACH(of) { {%- for k in range(count) %}of({{ k }}){{ ", " if not loop.last }}{% endfor -%} }
{% if batches or "add_lanes" in calls %}
#define LOWER_HALVES {% for k in range(count // 2) %}{{ k }}, {{ k + count }}{{ ", " if not loop.last }}{% endfor %}

#define UPPER_HALVES {% for k in range(count // 2, count) %}{{ k }}, {{ k + count }}{{ ", " if not loop.last }}{% endfor %}

{% endif %}
{% endfor %}
#endif
typedef {{ scalar.name }} lanes __attribute__((vector_size(LANE_BYTES)));
typedef {{ scalar.pattern }} pattern __attribute__((vector_size(LANE_BYTES)));
#endif

#define LANES (LANE_BYTES / {{ scalar.bytes }})

/* Comparison result as a lane mask: all bits of a lane set, or none. */
#if LANE_BYTES > {{ scalar.bytes }}
#define MASK(comparison) ((pattern)(comparison))
#else
#define MASK(comparison) (0 - (pattern)(comparison))
#endif

#if defined(__GNUC__)
#define ALIGNED __attribute__((aligned(64)))
{% if batches %}
#define APART __attribute__((noinline))
{% endif %}
#else
#define ALIGNED
{% if batches %}
#define APART
{% endif %}
#endif

/* Written before a short loop, which gcc -O2 would otherwise not unroll. */
#if defined(__GNUC__) && !defined(__clang__) && __GNUC__ >= 8
#define UNROLLED _Pragma("GCC unroll 8")
{% if batches %}
#define ROLLED _Pragma("GCC unroll 1") /* keeps a loop rolled: as fast, and faster to compile */
{% endif %}
#else
#define UNROLLED
{% if batches %}
#define ROLLED
{% endif %}
#endif

/*
 * First vector of row i of a symmetric matrix that is computed, for loops behind UNROLLED_ROWS. The narrowest vectors leave
 * out what lies below the diagonal; of wider ones too few do to pay for it.
 */
#define FIRST_BLOCK(i) (LANE_BYTES == 16 ? (i) / LANES : 0)
#if defined(__clang__) && LANE_BYTES == 16
#define UNROLLED_ROWS _Pragma("clang loop unroll(full)")
#else
#define UNROLLED_ROWS UNROLLED
#endif

/* The same lanes as numbers or as bit patterns. */
typedef union { lanes number; pattern bits; } lane_bits;

/* Round x to a {{ scalar.name }}, without the excess bits of a register. */
static inline {{ scalar.name }} as_{{ scalar.name }}({{ scalar.name }} x)
{
#if EXCESS_PRECISION
    const volatile {{ scalar.name }} stored = x;
    return stored;
#else
    return x;
#endif
}
