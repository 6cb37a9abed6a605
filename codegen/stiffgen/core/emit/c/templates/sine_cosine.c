{% set wide = scalar.name == "double" %}
{% if wide %}
/*
 * Compute sine and cosine of count vectors of angles [rad]. The error is below 1.1 ulp for |x| <= FAR (tested; the
 * largest error in a search of 10^8 angles was 1.056 ulp). Larger angles are computed by libm.
 *
 * Range reduction: k is the integer nearest to x / (pi/2). Adding 1.5 * 2^52 leaves k in the low bits of a double.
 * Subtracting one from the exponent, as an integer, halves the sum; subtracting 0.75 * 2^52 then gives turn = k/2. The
 * integer operation keeps compilers from cancelling the two constants. pi is the sum of three parts. The first two have
 * 39 bits, so that their products with turn (13 bits) are exact; the third extends the sum to 2^-130. The reduced angle
 * is r + low = x - turn pi, with |r| <= pi/4.
 *
 * Polynomials: sin r = r + r^3 P(r^2) and cos r = 1 - r^2/2 + r^4 Q(r^2). Remez' algorithm
 * (tests/campaigns/sine_cosine.py) minimises the largest relative error: 2^-57.9 for the sine, 2^-64.0 for the
 * cosine. k mod 4 decides whether the two are exchanged and which signs they get.
 */
{% else %}
/*
 * Compute sine and cosine of count vectors of angles [rad], in floats only. The error is below 1.1 ulp for |x| <= FAR; a
 * test of every such float found at most 1.02 ulp without fused multiply-add and 0.96 with it. Larger angles are computed
 * by libm.
 *
 * Range reduction: k is the integer nearest to x / (pi/2). Adding 1.5 * 2^23 leaves k in the low bits of a float.
 * Subtracting one from the exponent, as an integer, halves the sum; subtracting 0.75 * 2^23 then gives turn = k/2. The
 * integer operation keeps compilers from cancelling the two constants. pi is the sum of four parts. The first three have
 * 12 bits, so that their products with turn (12 bits) and the first two differences are exact; the fourth extends the sum
 * to 2^-62. The reduced angle is r + low = x - turn pi, with |r| <= pi/4.
 *
 * Polynomials: sin r = r + r^3 P(r^2) and cos r = 1 - r^2/2 + r^4 Q(r^2). Remez' algorithm
 * (tests/campaigns/sine_cosine.py) minimises the largest relative error: 2^-28.0 for the sine, 2^-33.0 for the
 * cosine. k mod 4 decides whether the two are exchanged and which signs they get.
 */
{% endif %}
#define FAR {{ "1e4" if wide else "6e3f" }}

/* Replace sines and cosines of angles beyond FAR, and of NaN, by those of the C library. */
static void by_libm_beyond_far(const {{ scalar.name }} *x, {{ scalar.name }} *sine, {{ scalar.name }} *cosine, int count)
{
    for (int k = 0; k < count; ++k) {
        if (!(fabs{{ scalar.suffix }}(x[k]) <= FAR)) {
            sine[k] = sin{{ scalar.suffix }}(x[k]);
            cosine[k] = cos{{ scalar.suffix }}(x[k]);
        }
    }
}

/*
 * Return x rounded to a {{ scalar.name }}, as a value that the compiler cannot take apart: sums are not reordered across it.
 * The barrier costs no instruction. For clang it is omitted: the pragma above already keeps the order, and the barrier
 * would restrict the choice of registers.
 */
static inline lanes whole(lanes x)
{
#if EXCESS_PRECISION
    x = as_{{ scalar.name }}(x);
#elif defined(__clang__) && __clang_major__ >= 13
#elif defined(__GNUC__) && defined(__SSE2__)
    __asm__("" : "+x"(x));
#elif defined(__GNUC__) && defined(__aarch64__)
    __asm__("" : "+w"(x));
#endif
    return x;
}

#if defined(__GNUC__) && LANE_BYTES <= 16
/* Called for different counts: a copy in each caller would make the code up to a fifth larger. */
__attribute__((noinline, unused)) static
#else
static inline
#endif
void sine_cosine(const lanes *x, lanes *sine, lanes *cosine, int count)
{
{% if wide %}
    const double round = 6755399441055744.0;
    /* Variables, because FLT_EVAL_METHOD lets constants have more digits than a double. */
    const double pi_1 = 3.1415926535846666, pi_2 = 5.1266883031811465e-12, pi_3 = 7.891108333126411e-24;
{% else %}
    const float round = 12582912.0f;
    /* Variables, because FLT_EVAL_METHOD lets constants have more digits than a float. */
    const float pi_1 = 3.140625f, pi_2 = 0.0009675026f, pi_3 = 1.5099067e-07f, pi_4 = 5.126688e-12f;
{% endif %}
    lanes reach = x[0] - x[0]; /* sum of all |x|: a sum up to FAR proves that no angle exceeds FAR */
    for (int n = 0; n < count; ++n) {
        lane_bits size, turns, halved, s, c;
        size.number = x[n];
        size.bits &= {{ "0x7fffffffffffffffULL" if wide else "0x7fffffffU" }};
        reach += size.number;

        turns.number = x[n] * {{ "0.6366197723675814" if wide else "0.63661975f" }} + round;
        halved.bits = turns.bits - {{ "0x0010000000000000ULL" if wide else "0x00800000U" }};
        const lanes turn = halved.number - 0.5{{ scalar.suffix }} * round;
{% if wide %}
        const lanes r1 = whole(x[n] - turn * pi_1);
        const lanes w2 = turn * pi_2;
        const lanes r2 = whole(r1 - w2);
        const lanes w3 = turn * pi_3;
        const lanes r = whole(r2 - w3);
        const lanes low = (whole(r1 - r2) - w2) + (whole(r2 - r) - w3);
{% else %}
        const lanes r1 = whole(x[n] - turn * pi_1);
        const lanes r2 = whole(r1 - turn * pi_2);
        const lanes w3 = turn * pi_3;
        const lanes r = whole(r2 - w3);
        const lanes low = (whole(r2 - r) - w3) - turn * pi_4;
{% endif %}

{% if wide %}
        const lanes z = r * r, z2 = z * z, z4 = z2 * z2;
        const lanes P = (z * 0.008333333333322118 - 0.1666666666666663)
            + z2 * (z * 2.7557313621376058e-06 - 0.00019841269829589558)
            + z4 * (z * 1.5896229931761321e-10 - 2.5050747759892582e-08);
        const lanes Q = (0.041666666666666595 - z * 0.0013888888888873056)
            + z2 * (2.480158728885165e-05 - z * 2.755731417927551e-07)
            + z4 * (2.087570083855632e-09 - z * 1.1358536325839214e-11);
{% else %}
        const lanes z = r * r, z2 = z * z;
        const lanes P = (z * 0.008332157f - 0.16666655f) - z2 * 0.00019514647f;
        const lanes Q = (0.041666646f - z * 0.001388731f) + z2 * 2.4432431e-05f;
{% endif %}
        const lanes half = 0.5{{ scalar.suffix }} * z;
        const lanes rest = whole(1.0{{ scalar.suffix }} - half);
        s.number = r + (low + (z * r) * P);
        c.number = rest + ((whole(1.0{{ scalar.suffix }} - rest) - half) + (z2 * Q - r * low));

        const pattern exchanged = (s.bits ^ c.bits) & (0 - (turns.bits & 1));
        s.bits ^= exchanged ^ ((turns.bits & 2) << {{ 62 if wide else 30 }});
        c.bits ^= exchanged ^ (((turns.bits + 1) & 2) << {{ 62 if wide else 30 }});
        sine[n] = s.number;
        cosine[n] = c.number;
    }
    {{ scalar.name }} sum = 0.0{{ scalar.suffix }};
    for (int n = 0; n < LANES; ++n) {
        sum += ((const {{ scalar.name }} *)&reach)[n];
    }
    if (!(sum <= FAR)) { /* true for NaN as well */
        by_libm_beyond_far((const {{ scalar.name }} *)x, ({{ scalar.name }} *)sine, ({{ scalar.name }} *)cosine, LANES * count);
    }
}
