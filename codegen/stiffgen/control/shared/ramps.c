/* Ramps of velocities. */
#include "shared.h"

/*
 * Return the share of full speed that stops within a way [s at full speed], if the share may change by `slope` per
 * sample T: v^2 = way / settling - 1/4, a ramp; from v = 1/2 on v = way / settling, exponential, or the arm overshoots.
 */
double stopping_speed(double way, double slope, double T)
{
    const double settling = 0.5 * T / slope; /* [s] time constant: the ramp's slope is T / (2 settling) */
    const double speed = way > 0.5 * settling ? sqrt(way / settling - 0.25) : larger(way / settling, slope);
    return smaller(way / T, speed); /* no farther than there in one sample */
}

/* Move a velocity (3) towards a wanted one, by `most` at most. */
void steer(const double *wanted, double most, double *velocity)
{
    double change[3];
    for (int i = 0; i < 3; ++i) {
        change[i] = wanted[i] - velocity[i];
    }
    const double over = larger(norm(3, change) / most, 1.0);
    for (int i = 0; i < 3; ++i) {
        velocity[i] += change[i] / over;
    }
}
