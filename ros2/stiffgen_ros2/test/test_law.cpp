// SPDX-License-Identifier: MIT
// Test without ROS: the arm holds, yields to a push, returns, releases after a NaN, and comes back after a reset.
#include "defaults.hpp"
#include "law.hpp"
#include "simulation.hpp"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

namespace robot = stiffgen_ros2::robot;

static int failed = 0;

static void check(bool good, const char *what, double value)
{
    std::printf("%s %s (%g)\n", good ? "ok    " : "FAILED", what, value);
    failed += !good;
}

static double distance(const robot::Array<4, 4> &a, const robot::Array<4, 4> &b)
{
    return std::hypot(a[3] - b[3], a[7] - b[7], a[11] - b[11]);
}

static double largest(const double *torque)
{
    double most = 0.0;
    for (std::size_t i = 0; i < robot::DOF; ++i) { most = std::isfinite(torque[i]) ? std::fmax(most, std::fabs(torque[i])) : 1e300; }
    return most;
}

struct Loop {
    stiffgen_ros2::Simulation arm;
    stiffgen_ros2::Law law;
    bool is_blind = false;

    void run(int cycles)
    {
        for (int cycle = 0; cycle < cycles; ++cycle) {
            stiffgen_ros2::Measured measured{arm.q, arm.dq, true};
            if (is_blind) { measured.q[0] = std::numeric_limits<double>::quiet_NaN(); }
            const robot::Report &report = law.step(measured, 1e-3);
            robot::Joints torque;
            for (std::size_t i = 0; i < robot::DOF; ++i) { torque[i] = report.torque[i]; }
            arm.step(torque, 1e-3);
        }
    }
};

// Run the law on a simulated arm, in samples of 1 ms: it holds, yields to a push, returns, and latches faults.
int main()
{
    Loop loop;
    stiffgen_ros2::Settings settings{};
    settings.config = stiffgen_ros2::default_config();
    settings.config.sample_time = 1e-3;
    settings.config.delay_samples = 0;
    settings.config.heaviest_wrench[0] = 100.0;
    settings.config.heaviest_wrench[1] = 20.0;
    settings.posture_stiffness.fill(1.0);
    std::copy(loop.arm.rotors.begin(), loop.arm.rotors.end(), settings.config.motor_inertia);
    for (std::size_t k = 0; k < 3; ++k) {
        settings.translation_stiffness[4 * k] = 400.0;
        settings.rotation_stiffness[4 * k] = 20.0;
    }
    settings.wrench_timeout = 0.5;
    for (std::size_t i = 0; i < robot::DOF; ++i) {
        const double lower = std::fmax(robot::LOWER[i], -1.0), upper = std::fmin(robot::UPPER[i], 1.0);
        loop.arm.q[i] = lower < upper ? lower + (i % 2 == 0 ? 0.5 : 0.75) * (upper - lower) : robot::LOWER[i];
    }
    const int error = loop.law.start(settings, false, loop.arm.q, robot::Joints{});
    check(error == robot::GOOD, robot::Impedance::error_text(error), error);
    const auto start = robot::forward_kinematics(loop.arm.q);
    loop.run(1000);
    const double still = distance(start, robot::forward_kinematics(loop.arm.q));
    loop.arm.push = {3.0, 3.0, 3.0, 0.0, 0.0, 0.0};
    loop.run(2000);
    const double moved = distance(start, robot::forward_kinematics(loop.arm.q));
    loop.arm.push = {};
    loop.run(5000);
    const double back = distance(start, robot::forward_kinematics(loop.arm.q));
    check(still < 1e-4, "the tip stays [m]", still);
    check(moved > 1e-4, "the tip yields to a push [m]", moved);
    check(back < 3e-3, "the tip returns [m]", back);
    check(loop.law.snapshot().faults == 0, "no fault", loop.law.snapshot().faults);

    loop.is_blind = true;
    loop.run(300);
    check(loop.law.snapshot().faults == 1, "a NaN is a fault", loop.law.snapshot().faults);
    check(largest(loop.law.snapshot().report.torque) < 1e6, "torques stay finite [N m]", largest(loop.law.snapshot().report.torque));
    loop.is_blind = false;
    loop.run(1000);
    loop.law.reset();
    loop.run(5000);
    check(loop.law.snapshot().report.fault == robot::NO_FAULT, "a reset ends the fault", loop.law.snapshot().report.fault);
    return failed;
}
