/* Volatile inputs keep the compiler from evaluating the checks; bits reveal NaN even if flags exclude it. */
int {{ name }}_self_check(void)
{
    int wrong = 0;
{% if "sine_cosine" in calls %}
{% if scalar.name == "double" %}
    static const volatile double angles[8]
        = {0.5, -1.0, 8.0, 3.141592653589793, 45.553093477052, 347.93138638506974, -1234.5, -9999.5};
    static const double sines[8] = {0.479425538604203, -0.8414709848078965, 0.9893582466233818, 1.2246467991473532e-16,
        1.0, 0.7071067811864472, -0.14539565052293643, -0.18828574191134848};
    static const double cosines[8] = {0.8775825618903728, 0.5403023058681398, -0.14550003380861354, -1.0,
        -6.189806365883577e-19, -0.7071067811866478, -0.989373592132422, -0.9821142903923622};
{% else %}
    static const volatile float angles[16] = {
        0.5f, -1.0f, 8.0f, 3.1415927f, 45.553093f, 347.93137f, -1234.5f, -5999.5f, 1.5707964f, -0.001f,
        2.3561945f, 1e-30f, 710.0f, -4000.25f, 100.53096f, 5.0f
    };
    static const float sines[16] = {
        0.47942555f, -0.84147096f, 0.98935825f, -8.742278e-08f, 1.0f, 0.7071212f, -0.14539565f, 0.8087174f,
        1.0f, -0.0009999999f, 0.70710677f, 1e-30f, 6.028871e-05f, 0.8428471f, -4.8318657e-06f, -0.9589243f
    };
    static const float cosines[16] = {
        0.87758255f, 0.5403023f, -0.14550003f, -1.0f, 5.2050905e-07f, -0.70709234f, -0.98937356f,
        0.58819735f, -4.371139e-08f, 0.9999995f, -0.70710677f, 1.0f, 1.0f, -0.5381531f, 1.0f, 0.2836622f
    };
{% endif %}
    lanes x[{{ scalar.widest }} / LANES], both[2][{{ scalar.widest }} / LANES];
    for (int n = 0; n < {{ scalar.widest }}; ++n) {
        (({{ scalar.name }} *)x)[n] = angles[n];
    }
    sine_cosine(x, both[0], both[1], {{ scalar.widest }} / LANES);
    for (int n = 0; n < {{ 2 * scalar.widest }}; ++n) {
        const {{ scalar.name }} exact = n < {{ scalar.widest }} ? sines[n] : cosines[n - {{ scalar.widest }}];
        const {{ scalar.name }} off = ((const {{ scalar.name }} *)both)[n] - exact, two_ulps = {{ "4.4e-16" if scalar.name == "double" else "2.4e-7f" }} * (exact < 0.0{{ scalar.suffix }} ? -exact : exact);
        wrong |= off <= two_ulps && -off <= two_ulps ? 0 : 1;
    }
{% endif %}
    static const volatile {{ scalar.name }} large = {{ scalar.limits }}_MAX;
    const {{ scalar.name }} infinite[2] = {large * 2.0{{ scalar.suffix }}, -large * 2.0{{ scalar.suffix }}};
    static const volatile {{ scalar.pattern }} quiet_nan = {{ "0x7ff8000000000000ULL" if scalar.name == "double" else "0x7fc00000U" }};
    const {{ scalar.pattern }} pattern_of_nan = quiet_nan; /* sums may be simplified; bits are not */
    {{ scalar.name }} nan;
    memcpy(&nan, &pattern_of_nan, sizeof nan);
    wrong |= nan == nan || nan <= large || nan > large || !(nan != nan) ? 2 : 0; /* is NaN a number to comparisons? */
    for (int n = 0; n < 2; ++n) {
        lanes infinities;
        {{ scalar.name }} stored[LANES * LANES];
        {{ scalar.pattern }} bits;
        for (int m = 0; m < LANES; ++m) {
            (({{ scalar.name }} *)&infinities)[m] = infinite[n];
        }
        const lanes finite = finite_lanes(infinities);
        memcpy(stored, &finite, sizeof finite);
        for (int round = 0; round < 2; ++round) {
            for (int m = 0; m < LANES; ++m) {
                memcpy(&bits, &stored[m], sizeof bits);
                wrong |= (bits << 1) > {{ "0xffe0000000000000ULL" if scalar.name == "double" else "0xff000000U" }} ? 0 : 2;
            }
            put_entries(stored, LANES, 0, &infinities, 0, LANES);
        }
{% if "finite_or_nan" in calls %}
        stored[0] = finite_or_nan(infinite[n]);
        memcpy(&bits, stored, sizeof bits);
        wrong |= (bits << 1) > {{ "0xffe0000000000000ULL" if scalar.name == "double" else "0xff000000U" }} ? 0 : 2;
{% endif %}
    }
    return wrong;
}
