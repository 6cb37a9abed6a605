/* Inputs are volatile, so that nothing here is computed when compiling; NaN is read from the bits. */
int {{ name }}_self_check(void)
{
    int wrong = 0;
{% if "sine_cosine" in calls %}
    static const volatile double angles[8]
        = {0.5, -1.0, 8.0, 3.141592653589793, 45.553093477052, 347.93138638506974, -1234.5, -9999.5};
    static const double sines[8] = {0.479425538604203, -0.8414709848078965, 0.9893582466233818, 1.2246467991473532e-16,
        1.0, 0.7071067811864472, -0.14539565052293643, -0.18828574191134848};
    static const double cosines[8] = {0.8775825618903728, 0.5403023058681398, -0.14550003380861354, -1.0,
        -6.189806365883577e-19, -0.7071067811866478, -0.989373592132422, -0.9821142903923622};
    lanes x[8 / LANES], both[2][8 / LANES];
    for (int n = 0; n < 8; ++n) {
        ((double *)x)[n] = angles[n];
    }
    sine_cosine(x, both[0], both[1], 8 / LANES);
    for (int n = 0; n < 16; ++n) {
        const double exact = n < 8 ? sines[n] : cosines[n - 8];
        const double off = ((const double *)both)[n] - exact, two_ulps = 4.4e-16 * (exact < 0.0 ? -exact : exact);
        if (!(off <= two_ulps && -off <= two_ulps)) {
            wrong |= 1;
        }
    }
{% endif %}
    static const volatile double large = DBL_MAX;
    const double infinite[2] = {large * 2.0, -large * 2.0};
    for (int n = 0; n < 2; ++n) {
        lanes given, kept;
        double put[LANES * LANES];
        unsigned long long bits;
        for (int m = 0; m < LANES; ++m) {
            ((double *)&given)[m] = infinite[n];
        }
        kept = finite_lanes(given);
        memcpy(put, &kept, sizeof kept);
        for (int twice = 0; twice < 2; ++twice) {
            for (int m = 0; m < LANES; ++m) {
                memcpy(&bits, &put[m], sizeof bits);
                wrong |= (bits << 1) > 0xffe0000000000000ULL ? 0 : 2;
            }
            put_entries(put, LANES, 0, &given, 0, LANES);
        }
{% if "finite_or_nan" in calls %}
        put[0] = finite_or_nan(infinite[n]);
        memcpy(&bits, put, sizeof bits);
        wrong |= (bits << 1) > 0xffe0000000000000ULL ? 0 : 2;
{% endif %}
    }
    return wrong;
}
