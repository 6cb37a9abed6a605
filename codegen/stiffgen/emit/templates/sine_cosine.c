/*
 * Sine and cosine of count lanes of angles, within 1 ulp up to FAR, by libm beyond it.
 *
 * k is the nearest integer to x / (pi/2): adding 1.5 * 2^52 leaves it in the low bits of a double. pi/2 is taken in
 * three parts; the first two have 39 bits, so that their products with k (13 bits) are exact, and the rest carries
 * the sum to 2^-131. r + low is x - k pi/2. On |r| <= pi/4, sin r = r + r^3 P(r^2) and cos r = 1 - r^2/2 + r^4 Q(r^2)
 * with the P and Q of least largest relative error (2^-57.9 and 2^-64.0), found by Remez' algorithm
 * (benchmarks/sine_cosine.py). k mod 4 then exchanges the two and sets their signs.
 */
#define FAR 1e4

static void by_libm_beyond_far(const double *x, double *sine, double *cosine, int count)
{
    for (int k = 0; k < count; ++k) {
        if (!(fabs(x[k]) <= FAR)) {
            sine[k] = sin(x[k]);
            cosine[k] = cos(x[k]);
        }
    }
}

static inline void sine_cosine(const lanes *x, lanes *sine, lanes *cosine, int count)
{
    const double round = 6755399441055744.0;
    lanes reach = x[0] - x[0]; /* sum of all |x|: at most FAR if no angle is beyond it, or if it does not matter */
    for (int n = 0; n < count; ++n) {
        lane_bits size, turns, s, c;
        size.number = x[n];
        size.bits &= 0x7fffffffffffffffULL;
        reach += size.number;

        turns.number = x[n] * 0.6366197723675814 + round;
        const lanes k = turns.number - round;
        const lanes r1 = x[n] - k * 1.5707963267923333;
        const lanes w2 = k * 2.5633441515905732e-12;
        const lanes r2 = r1 - w2;
        const lanes w3 = k * 3.9455541665632055e-24;
        const lanes r = r2 - w3;
        const lanes low = ((r1 - r2) - w2) + ((r2 - r) - w3);

        const lanes z = r * r, z2 = z * z, z4 = z2 * z2;
        const lanes P = (z * 0.008333333333322118 - 0.1666666666666663)
            + z2 * (z * 2.7557313621376058e-06 - 0.00019841269829589558)
            + z4 * (z * 1.5896229931761321e-10 - 2.5050747759892582e-08);
        const lanes Q = (0.041666666666666595 - z * 0.0013888888888873056)
            + z2 * (2.480158728885165e-05 - z * 2.755731417927551e-07)
            + z4 * (2.087570083855632e-09 - z * 1.1358536325839214e-11);
        const lanes half = 0.5 * z;
        const lanes rest = 1.0 - half;
        s.number = r + (low + (z * r) * P);
        c.number = rest + (((1.0 - rest) - half) + (z2 * Q - r * low));

        const pattern exchanged = (s.bits ^ c.bits) & (0 - (turns.bits & 1));
        s.bits ^= exchanged ^ ((turns.bits & 2) << 62);
        c.bits ^= exchanged ^ (((turns.bits + 1) & 2) << 62);
        sine[n] = s.number;
        cosine[n] = c.number;
    }
    double sum = 0.0;
    for (int n = 0; n < LANES; ++n) {
        sum += ((const double *)&reach)[n];
    }
    if (!(sum <= FAR)) { /* also if it is NaN */
        by_libm_beyond_far((const double *)x, (double *)sine, (double *)cosine, LANES * count);
    }
}
