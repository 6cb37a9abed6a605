/* Numbers and vectors. Comparisons in place of fmin and fmax: compilers call those as functions. */
#include "shared.h"

double larger(double x, double y) { return x > y ? x : y; }

double smaller(double x, double y) { return x < y ? x : y; }

double clamp(double x, double least, double most)
{
    const double low = x < least ? least : x;
    return low > most ? most : low;
}

double dot(int count, const double *a, const double *b)
{
    double sum = 0.0;
    for (int i = 0; i < count; ++i) {
        sum += a[i] * b[i];
    }
    return sum;
}

double norm(int count, const double *x) { return sqrt(dot(count, x, x)); }

void divide(int count, double divisor, double *x)
{
    for (int i = 0; i < count; ++i) {
        x[i] /= divisor;
    }
}

/* Return whether all entries lie between the bounds (both allowed); NaN does not. */
int doubles_within(const double *x, size_t count, double least, double most)
{
    for (size_t i = 0; i < count; ++i) {
        if (!(x[i] >= least && x[i] <= most)) {
            return 0;
        }
    }
    return 1;
}

/* Return whether all numbers are finite, and no mistakes. */
int all_finite(const double *x, int count) { return doubles_within(x, (size_t)count, -FARTHEST, FARTHEST); }
