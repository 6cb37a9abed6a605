// SPDX-License-Identifier: MIT
// Parameters that are fields of the controller's configuration: NAME_impedance.h has their meaning, range and default.
#pragma once

#include "robot.hpp"

#include <cstddef>

namespace stiffgen_ros2 {

/// Field of numbers: a parameter with one number, or an array of one number or of as many as the field has.
struct Numbers {
    const char *name;
    std::size_t count; ///< 0: one number, not an array
    double *(*at)(robot::Config &);
};

struct Integer {
    const char *name;
    int *(*at)(robot::Config &);
};

/// Field that is one of two or three words.
struct Choice {
    const char *name;
    int *(*at)(robot::Config &);
    const char *words[3]; ///< nullptr in place of a third one that is missing
    int values[3];
};

#define STIFFGEN_NUMBER(field) {#field, 0, [](robot::Config &c) { return &c.field; }}
#define STIFFGEN_JOINTS(field) {#field, robot::DOF, [](robot::Config &c) { return &c.field[0]; }}
#define STIFFGEN_PAIR(field) {#field, 2, [](robot::Config &c) { return &c.field[0]; }}
#define STIFFGEN_INTEGER(field) {#field, [](robot::Config &c) { return &c.field; }}

inline constexpr Numbers NUMBERS[] = {
    STIFFGEN_NUMBER(position_quantum),
    STIFFGEN_NUMBER(velocity_noise),
    STIFFGEN_NUMBER(damping_ratio),
    STIFFGEN_NUMBER(ramp_time),
    STIFFGEN_NUMBER(tank_initial),
    STIFFGEN_PAIR(heaviest_wrench),
    STIFFGEN_PAIR(tip_velocity_limit),
    STIFFGEN_JOINTS(motor_inertia),
    STIFFGEN_JOINTS(lower_limit),
    STIFFGEN_JOINTS(upper_limit),
    STIFFGEN_JOINTS(velocity_limit),
    STIFFGEN_JOINTS(effort_limit),
    STIFFGEN_JOINTS(torque_rate_limit),
    STIFFGEN_JOINTS(coulomb_friction),
};

inline constexpr Integer INTEGERS[] = {
    STIFFGEN_INTEGER(delay_samples),
    STIFFGEN_INTEGER(missed_limit),
    STIFFGEN_INTEGER(call_gap_limit),
};

inline constexpr Choice CHOICES[] = {
    {"coriolis", [](robot::Config &c) { return &c.coriolis; }, {"off", "on"}, {robot::CORIOLIS_OFF, robot::CORIOLIS_ON}},
    {"communication_reaction", [](robot::Config &c) { return &c.communication_reaction; }, {"release", "hold", "resume"},
        {robot::REACTION_RELEASE, robot::REACTION_HOLD, robot::REACTION_RESUME}},
};

#undef STIFFGEN_NUMBER
#undef STIFFGEN_JOINTS
#undef STIFFGEN_PAIR
#undef STIFFGEN_INTEGER

} // namespace stiffgen_ros2
