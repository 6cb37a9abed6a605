// SPDX-License-Identifier: MIT
// Simulated arm: M(q) ddq + C(q, dq) dq = torque + J^T push - friction dq. Gravity counts as compensated.
#pragma once

#include "defaults.hpp"
#include "robot.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace stiffgen_ros2 {

class Simulation {
public:
    Simulation()
    {
        const robot::Config limits = default_config();
        for (std::size_t i = 0; i < robot::DOF; ++i) { rotors[i] = ROTOR_TIME * limits.effort_limit[i] / limits.velocity_limit[i]; }
    }

    robot::Joints q{}, dq{};
    robot::Joints rotors; // [kg m^2 or kg] an estimate: at the effort limit a rotor reaches its velocity limit in ROTOR_TIME
    std::array<double, 6> push{}; // [N, N m] wrench that the environment applies at the tip, hybrid axes

    /// Apply a torque for a time [s]; a torque that is not finite counts as 0.
    void step(const robot::Joints &torque, double time)
    {
        const int steps = std::max(1, static_cast<int>(std::ceil(time / LONGEST_STEP)));
        for (int k = 0; k < steps; ++k) { substep(torque, time / steps); }
    }

private:
    static constexpr double FRICTION = 0.2; // N m s/rad or N s/m
    static constexpr double ROTOR_TIME = 0.005; // s
    static constexpr double LONGEST_STEP = 5e-4; // [s] of the semi-implicit Euler method

    void substep(const robot::Joints &torque, double dt)
    {
        auto mass = robot::mass_matrix(q);
        const auto jacobian = robot::hybrid::jacobian(q);
        const auto bias = robot::bias_forces(q, dq, std::array<double, 3>{});
        robot::Joints force;
        for (std::size_t i = 0; i < robot::DOF; ++i) {
            mass[i * robot::DOF + i] += rotors[i];
            force[i] = (std::isfinite(torque[i]) ? torque[i] : 0.0) - bias[i] - FRICTION * dq[i];
            for (std::size_t k = 0; k < 6; ++k) { force[i] += jacobian[k * robot::DOF + i] * push[k]; }
        }
        solve(mass, force);
        for (std::size_t i = 0; i < robot::DOF; ++i) {
            dq[i] += force[i] * dt;
            q[i] += dq[i] * dt;
        }
    }

    // Replace force by A^-1 force by Gauss' elimination; A is positive definite and needs no pivots.
    static void solve(robot::Array<robot::DOF, robot::DOF> &A, robot::Joints &force)
    {
        constexpr std::size_t n = robot::DOF;
        for (std::size_t k = 0; k < n; ++k) {
            for (std::size_t i = k + 1; i < n; ++i) {
                const double factor = A[i * n + k] / A[k * n + k];
                for (std::size_t j = k; j < n; ++j) { A[i * n + j] -= factor * A[k * n + j]; }
                force[i] -= factor * force[k];
            }
        }
        for (std::size_t i = n; i-- > 0;) {
            for (std::size_t j = i + 1; j < n; ++j) { force[i] -= A[i * n + j] * force[j]; }
            force[i] /= A[i * n + i];
        }
    }
};

} // namespace stiffgen_ros2
