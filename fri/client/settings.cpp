// SPDX-License-Identifier: MIT
#include "settings.h"

#include <algorithm>

/* Set the defaults, in SI units. */
Settings::Settings()
    : paper(false), conventional(false), damping_ratio(0.7), posture_stiffness(10.0), motor_inertia(0.1),
      press_force(0.0), effort_share(0.25), torque_rise(0.25), speed_share(0.9), sample_time(0.0), approach_time(5.0),
      approach_limit(0.8), approach_anyway(false), may_ask(false), velocity_span(0.008), delay_samples(0),
      position_quantum(0.0), wrench_damping(0.01), external_torque_sign(1.0), pace(), dry_run(false),
      simulated_time(false)
{
    /* Stiffness of the paper. */
    const double stiffness[6] = {700.0, 700.0, 800.0, 30.0, 30.0, 30.0};
    std::copy(stiffness, stiffness + 6, task_stiffness);
    std::fill(friction, friction + 7, 0.0);
    std::fill(settle_force, settle_force + 2, 0.0);
    /* The bowl wiping has 0.1 m, 3.7 J and 85 N. */
    pace.error = 0.2;
    pace.lag = 0.3;
    pace.energy = 6.0;
    pace.force = 150.0;
    pace.patience = 3.0;
}
