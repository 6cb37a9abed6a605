/*
 * Required arithmetic: {{ scalar.name }}s of {{ scalar.bits }} bits, NaN and infinity, sums in the order in which they are written. A
 * compiler flag that changes the arithmetic is an error here if a macro reveals it; {{ name }}_self_check finds others.
 */
#if defined(__FAST_MATH__) || defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile without -ffast-math, -ffinite-math-only and /fp:fast: they drop NaN, infinity and the order of sums"
#elif defined(__ASSOCIATIVE_MATH__) || defined(__NO_SIGNED_ZEROS__)
#error "compile without -Ofast, -funsafe-math-optimizations, -fassociative-math and -fno-signed-zeros"
#elif FLT_RADIX != 2 || {{ scalar.limits }}_MANT_DIG != {{ scalar.bits }}
#error "{{ scalar.name }} must have {{ scalar.bits }} bits"
#endif
{% if scalar.name == "double" %}
typedef char constants_must_be_doubles[sizeof(1.0) == 8 ? 1 : -1]; /* fails with -fsingle-precision-constant */
{% else %}
typedef char an_int_must_be_as_long_as_a_float[sizeof(float) == sizeof(unsigned) ? 1 : -1];
{% endif %}
#if defined(__clang__)
#pragma clang fp reassociate(off)
#endif

/* Nonzero if registers hold numbers of more than {{ scalar.bits }} bits (x87{{ ", and machines that compute floats as doubles" if scalar.name == "float" }}). */
{% macro excess(method) %}{{ method }} < 0 || {% if scalar.name == "float" %}{{ method }} == 1 || {% endif %}{{ method }} == 2{% endmacro %}
#if defined(__FLT_EVAL_METHOD__)
#define EXCESS_PRECISION ({{ excess("__FLT_EVAL_METHOD__") }})
#elif defined(_M_IX86_FP)
#define EXCESS_PRECISION (_M_IX86_FP < 2)
#else
#define EXCESS_PRECISION ({{ excess("FLT_EVAL_METHOD") }})
#endif
