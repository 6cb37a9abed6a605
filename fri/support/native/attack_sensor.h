// SPDX-License-Identifier: MIT
#ifndef FRI_ATTACK_SENSOR_H
#define FRI_ATTACK_SENSOR_H

/* The force-torque sensor of a hostile robot. */
#include "attack_arm.h"

#include "wrench.h"

namespace {

/* Reads what the wall does to the tip, without bias and payload. */
class ContactSensor : public WrenchSensor {
public:
    /* Measure a force on the tip [N]; schedule: its faults. */
    void measure(const Schedule &schedule, double time, const Vector &q, const double *force)
    {
        double wrench[6] = {0.0};
        std::copy(force, force + 3, wrench);
        if (schedule.at("numb", time) == NULL) {
            solve(q.data(), wrench);
            const double share = schedule.value("weak", time, 1.0);
            std::transform(wrench, wrench + 6, reading_,
                           [&](double part) { return share * part + NOISE * (2.0 * uniform_(random_) - 1.0); });
        }
        fresh_ = fresh_ || schedule.at("mute", time) == NULL;
    }

    bool read(double reading[6]) override
    {
        std::copy(reading_, reading_ + 6, fresh_ ? reading : lost_);
        const bool fresh = fresh_;
        fresh_ = false;
        return fresh;
    }

private:
    /* Replace a wrench at the tip by the reading of it: the client's function is linear in the reading. */
    static void solve(const double *q, double *x)
    {
        const double none[6] = {0.0};
        double A[6][6], column[6];
        for (int j = 0; j < 6; ++j) {
            double unit[6] = {0.0};
            unit[j] = 1.0;
            robot::tip_wrench(q, unit, none, none, column);
            for (int i = 0; i < 6; ++i) {
                A[i][j] = column[i];
            }
        }
        for (int k = 0; k < 6; ++k) { /* Gauss-Jordan; the largest entry of the column comes first */
            int best = k;
            for (int i = k + 1; i < 6; ++i) {
                best = std::fabs(A[i][k]) > std::fabs(A[best][k]) ? i : best;
            }
            std::swap_ranges(A[k], A[k] + 6, A[best]);
            std::swap(x[k], x[best]);
            for (int i = 0; i < 6; ++i) {
                const double share = i == k ? 0.0 : A[i][k] / A[k][k];
                for (int j = 0; j < 6; ++j) {
                    A[i][j] -= share * A[k][j];
                }
                x[i] -= share * x[k];
            }
        }
        for (int k = 0; k < 6; ++k) {
            x[k] /= A[k][k];
        }
    }

    static constexpr double NOISE = 0.05; /* [N, N m] */

    std::mt19937 random_;
    std::uniform_real_distribution<double> uniform_{0.0, 1.0};
    double reading_[6] = {0.0}, lost_[6];
    bool fresh_ = false;
};

} // namespace

#endif
