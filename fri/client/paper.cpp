// SPDX-License-Identifier: MIT
/* PaperTorque: the law of the paper inside the client. */
#include "paper.h"

#include "wrench.h"

#include <cmath>
#include <cstring>

PaperTorque::PaperTorque()
{
    std::memset(&input_, 0, sizeof input_);
    robot::paper_default_config(&config_);
    begin();
}

/* Set formula, gains and limits; task_stiffness has six diagonal entries [N/m, N m/rad]. */
void PaperTorque::configure(bool conventional, const double *task_stiffness, double posture_stiffness,
                            double damping_ratio, const robot::Config &controller)
{
    config_.conventional = conventional ? 1 : 0;
    config_.damping_ratio = damping_ratio;
    config_.joint_damping = 0.0;
    config_.posture_stiffness = posture_stiffness;
    std::memcpy(config_.motor_inertia, controller.motor_inertia, sizeof config_.motor_inertia);
    std::memcpy(config_.effort_limit, controller.effort_limit, sizeof config_.effort_limit);
    std::memcpy(config_.torque_rate_limit, controller.torque_rate_limit, sizeof config_.torque_rate_limit);
    for (int i = 0; i < 6; ++i) {
        input_.task_stiffness[7 * i] = task_stiffness[i];
    }
}

void PaperTorque::begin()
{
    std::memset(&state_, 0, sizeof state_);
    std::memset(&output_, 0, sizeof output_);
}

/* Compute the paper's torque for a sample; in a fault, at the measured position and without a wrench. */
void PaperTorque::step(double sample_time, const robot::Input &sample, const double *wrench, bool faulted)
{
    std::memcpy(input_.q, sample.q, sizeof input_.q);
    std::memcpy(input_.dq, sample.dq, sizeof input_.dq);
    std::memcpy(input_.q0, faulted ? sample.q : sample.q0, sizeof input_.q0);
    std::memcpy(input_.wrench, wrench, sizeof input_.wrench);
    if (faulted) {
        std::memset(input_.wrench, 0, sizeof input_.wrench);
    } else if (!is_plausible(wrench)) {
        input_.wrench[0] = std::nan("");
    }
    config_.sample_time = sample_time;
    robot::paper_step(&config_, &state_, &input_, &output_);
}

/* Return half of torque times deflection [J]: the law has no energy of its own. */
double PaperTorque::energy() const
{
    double sum = 0.0;
    for (int i = 0; i < robot::DOF; ++i) {
        sum += 0.5 * output_.elastic_torque[i] * (input_.q0[i] - input_.q[i]);
    }
    return sum;
}
