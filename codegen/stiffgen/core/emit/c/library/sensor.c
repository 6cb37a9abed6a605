#include "sensor.h"

/* Rotate the columns of A and of V until those of A are orthogonal: A V, one-sided Jacobi. */
void CALL(orthogonalise)(double A[ID(DOF)][6], double V[6][6])
{
    int is_turning = 1;
    for (int sweep = 0; is_turning && sweep < 20; ++sweep) {
        is_turning = 0;
        for (int p = 0; p < 5; ++p) {
            for (int k = p + 1; k < 6; ++k) {
                double first = 0.0, second = 0.0, both = 0.0; /* products of the columns p and k */
                for (int i = 0; i < ID(DOF); ++i) {
                    first += A[i][p] * A[i][p];
                    second += A[i][k] * A[i][k];
                    both += A[i][p] * A[i][k];
                }
                if (!(fabs(both) > 1e-15 * sqrt(first * second))) {
                    continue;
                }
                /* cotangent of twice the angle that makes them orthogonal; t, c, s: its tangent, cosine, sine */
                const double ratio = (second - first) / (2.0 * both);
                const double t = copysign(1.0, ratio) / (fabs(ratio) + sqrt(1.0 + ratio * ratio));
                const double c = 1.0 / sqrt(1.0 + t * t), s = c * t;
                for (int i = 0; i < ID(DOF); ++i) {
                    const double x = A[i][p], y = A[i][k];
                    A[i][p] = c * x - s * y;
                    A[i][k] = s * x + c * y;
                }
                for (int i = 0; i < 6; ++i) {
                    const double x = V[i][p], y = V[i][k];
                    V[i][p] = c * x - s * y;
                    V[i][k] = s * x + c * y;
                }
                is_turning = 1;
            }
        }
    }
}

/*
 * Estimate the wrench that the environment applies to the robot at the tip from external joint torques: weighted least
 * squares of J^T wrench = torque.
 * jacobian: hybrid Jacobian of the tip, 6 rows
 * torque: external torques, measured less modelled ones [N m or N]
 * deviation: standard deviations of the torques, all above 0 [N m or N]; NULL: all are 1
 * damping: a component of singular value s of J^T, its rows divided by the deviations, shrinks by
 *     s^2 / (s^2 + damping^2); 0: none
 * wrench: (force, moment) in base axes, moment about the tip's origin [N, N m]; NaN if an argument is not finite, and
 *     without damping where the condition is 1e10 or more
 * unexplained: torque - J^T wrench; NULL: not wanted
 * Return the condition number of J^T, its rows divided by the deviations: infinity with fewer than six joints, NaN if
 * the Jacobian is not finite.
 */
double CALL(external_wrench)(const double jacobian[6 * ID(DOF)], const double torque[ID(DOF)],
    const double *deviation, double damping, double wrench[6], double *unexplained)
{
    double A[ID(DOF)][6], V[6][6] = {{0.0}}; /* A: J^T, its rows divided by the deviations */
    double nan_of_jacobian = 0.0, nan_of_others = 0.0 * damping; /* NaN if a number is not finite, else 0 */
    for (int i = 0; i < ID(DOF); ++i) {
        for (int k = 0; k < 6; ++k) {
            A[i][k] = jacobian[ID(DOF) * k + i] / (deviation != NULL ? deviation[i] : 1.0);
            nan_of_jacobian += 0.0 * A[i][k];
        }
        nan_of_others += 0.0 * torque[i];
    }
    for (int k = 0; k < 6; ++k) {
        V[k][k] = 1.0;
        wrench[k] = nan_of_jacobian + nan_of_others;
    }
    /* A V has orthogonal columns a_k. With t = torque / deviation, wrench = V y,
     * y_k = a_k . t / (|a_k|^2 + damping^2). */
    CALL(orthogonalise)(A, V);
    double squares[6], largest = 0.0, smallest = (double)INFINITY; /* |a_k|^2: singular values squared */
    for (int k = 0; k < 6; ++k) {
        squares[k] = 0.0;
        for (int i = 0; i < ID(DOF); ++i) {
            squares[k] += A[i][k] * A[i][k];
        }
        largest = squares[k] > largest ? squares[k] : largest;
        smallest = squares[k] < smallest ? squares[k] : smallest;
    }
    const int is_bounded = ID(DOF) >= 6 && smallest > 0.0;
    const double condition = nan_of_jacobian + (is_bounded ? sqrt(largest / smallest) : (double)INFINITY);
    for (int k = 0; k < 6; ++k) {
        double along = 0.0;
        for (int i = 0; i < ID(DOF); ++i) {
            along += A[i][k] * torque[i] / (deviation != NULL ? deviation[i] : 1.0);
        }
        along /= damping > 0.0 || condition < 1e10 ? squares[k] + damping * damping : (double)NAN;
        for (int i = 0; i < 6; ++i) {
            wrench[i] += V[i][k] * along;
        }
    }
    for (int i = 0; unexplained != NULL && i < ID(DOF); ++i) {
        unexplained[i] = torque[i];
        for (int k = 0; k < 6; ++k) {
            unexplained[i] -= jacobian[ID(DOF) * k + i] * wrench[k];
        }
    }
    return condition;
}

/*
 * Filter of second order for six channels: y = b[0] x + b[1] x1 + b[2] x2 - a[0] y1 - a[1] y2, of which x1, y1 are one
 * sample old.
 * delay: [samples] delay of a slow signal (group delay at zero frequency). The output belongs to the sample that is so
 *     old: use q of that time with it, or correct the force by its rate.
 */
typedef struct CALL(filter) {
    double b[3], a[2], delay;
    double state[6][2];
    int is_started;
} CALL(filter);

/* Set coefficients and delay; the first sample then starts the filter at rest. */
void CALL(filter_of)(
    CALL(filter) *filter, double b0, double b1, double b2, double a1, double a2)
{
    memset(filter, 0, sizeof *filter);
    filter->b[0] = b0;
    filter->b[1] = b1;
    filter->b[2] = b2;
    filter->a[0] = a1;
    filter->a[1] = a2;
    filter->delay = (b1 + 2.0 * b2) / (b0 + b1 + b2) - (a1 + 2.0 * a2) / (1.0 + a1 + a2);
}

/* Return whether a frequency is above zero and below half the sampling rate. */
int CALL(filter_accepts)(double frequency, double sample_time)
{
    return frequency > 0.0 && sample_time > 0.0 && frequency * sample_time < 0.5;
}

/*
 * First-order low pass: y += (1 - exp(-2 pi frequency sample_time)) (x - y). The newest reading counts as if it had
 * been there since the sample before: a continuous filter whose input is held until the next sample is a sample later.
 * frequency: [Hz] corner, below half the sampling rate; sample_time: [s]. The gain at the corner is 1/sqrt(2) up to
 * 0.1 % below a fiftieth of the sampling rate; it is 0.719 at a tenth and 0.776 at a quarter. Return 0, and leave the
 * filter unchanged, for another frequency.
 */
int CALL(low_pass_1)(CALL(filter) *filter, double frequency, double sample_time)
{
    if (!CALL(filter_accepts)(frequency, sample_time)) {
        return 0;
    }
    const double gone = -expm1(-6.283185307179586 * frequency * sample_time);
    CALL(filter_of)(filter, gone, 0.0, 0.0, gone - 1.0, 0.0);
    return 1;
}

/* Second-order low pass of Butterworth, by the bilinear transform with the corner in its place; arguments as above. */
int CALL(low_pass_2)(CALL(filter) *filter, double frequency, double sample_time)
{
    if (!CALL(filter_accepts)(frequency, sample_time)) {
        return 0;
    }
    const double t = tan(3.141592653589793 * frequency * sample_time), norm = 1.0 + 1.4142135623730951 * t + t * t;
    const double b = t * t / norm;
    CALL(filter_of)(filter, b, 2.0 * b, b, 2.0 * (t * t - 1.0) / norm,
        (1.0 - 1.4142135623730951 * t + t * t) / norm);
    return 1;
}

/*
 * Notch: no output at the frequency [Hz]; width [Hz]: distance of the frequencies at which 1/sqrt(2) passes. Return 0,
 * and leave the filter unchanged, unless 0 < width and the frequency is below half the sampling rate.
 */
int CALL(notch)(CALL(filter) *filter, double frequency, double width, double sample_time)
{
    if (!CALL(filter_accepts)(frequency, sample_time) || !CALL(filter_accepts)(width, sample_time)) {
        return 0;
    }
    const double t = tan(3.141592653589793 * width * sample_time), b = 1.0 / (1.0 + t);
    const double middle = -2.0 * b * cos(6.283185307179586 * frequency * sample_time);
    CALL(filter_of)(filter, b, middle, b, middle, (1.0 - t) * b);
    return 1;
}

/*
 * Filter a reading in place, once per sample. The first reading passes unchanged. A reading that is not finite becomes
 * NaN and starts the filter anew.
 */
void CALL(filter_step)(CALL(filter) *filter, double reading[6])
{
    int is_finite = 1;
    for (int k = 0; k < 6; ++k) {
        is_finite = is_finite && isfinite(reading[k]);
    }
    for (int k = 0; k < 6; ++k) {
        double *s = filter->state[k];
        const double x = is_finite ? reading[k] : (double)NAN;
        if (!filter->is_started) {
            /* the state in which a constant x has become gain * x */
            const double gain = (filter->b[0] + filter->b[1] + filter->b[2]) / (1.0 + filter->a[0] + filter->a[1]);
            s[1] = (filter->b[2] - filter->a[1] * gain) * x;
            s[0] = (filter->b[1] - filter->a[0] * gain) * x + s[1];
        }
        const double y = filter->b[0] * x + s[0]; /* direct form II transposed */
        s[0] = filter->b[1] * x - filter->a[0] * y + s[1];
        s[1] = filter->b[2] * x - filter->a[1] * y;
        reading[k] = y;
    }
    filter->is_started = is_finite;
}

/*
 * Read an array of numbers behind "key" in the text of a calibration's file. Return 1, or 0 without these numbers:
 * values are then unchanged in part.
 */
int CALL(numbers_of)(const char *text, const char *key, double *values, size_t count)
{
    const char *at = strstr(text, key);
    at = at == NULL ? NULL : strchr(at, '[');
    for (size_t k = 0; at != NULL && k < count; ++k) {
        char *end = NULL;
        values[k] = strtod(at + 1, &end);
        if (end == at + 1 || !isfinite(values[k])) {
            return 0;
        }
        at = strchr(end, k + 1 < count ? ',' : ']');
        if (at == NULL || at != end) {
            return 0;
        }
    }
    return at != NULL;
}

/*
 * Read bias (6) and payload (4) from the text of a file that 'stiffgen calibrate' wrote; text ends with a zero. Return
 * 0 if one is missing: neither can then be used. strtod reads numbers in the program's locale.
 */
int CALL(read_calibration)(const char *text, double bias[6], double payload[4])
{
    return CALL(numbers_of)(text, "\"bias\"", bias, 6) && CALL(numbers_of)(text, "\"payload\"", payload, 4);
}
