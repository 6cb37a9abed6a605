/*
 * The arithmetic that this file needs: doubles of 53 bits, NaN and infinity, sums in the order in which they are
 * written. Flags that change it and can be seen here do not compile; the self-check at the end finds the others.
 */
#if defined(__FAST_MATH__) || defined(_M_FP_FAST) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile without -ffast-math, -ffinite-math-only and /fp:fast: they drop NaN, infinity and the order of sums"
#elif defined(__ASSOCIATIVE_MATH__) || defined(__NO_SIGNED_ZEROS__)
#error "compile without -Ofast, -funsafe-math-optimizations, -fassociative-math and -fno-signed-zeros"
#elif FLT_RADIX != 2 || DBL_MANT_DIG != 53
#error "double must have 53 bits"
#endif
typedef char constants_must_be_doubles[sizeof(1.0) == 8 ? 1 : -1]; /* not with -fsingle-precision-constant */
#if defined(__clang__)
#pragma clang fp reassociate(off)
#endif

/* Whether numbers in registers have more than 53 bits (x87). */
#if defined(__FLT_EVAL_METHOD__)
#define EXCESS_PRECISION (__FLT_EVAL_METHOD__ < 0 || __FLT_EVAL_METHOD__ == 2)
#elif defined(_M_IX86_FP)
#define EXCESS_PRECISION (_M_IX86_FP < 2)
#else
#define EXCESS_PRECISION (FLT_EVAL_METHOD < 0 || FLT_EVAL_METHOD == 2)
#endif
