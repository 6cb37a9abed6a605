// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_PAPER_H
#define FRI_CLIENT_PAPER_H

#include "robot.h"

/*
 * Law of the paper. Its torque is the caller's torque_offset of a controller without springs, which checks the samples,
 * damps, keeps off the joint limits and finds faults.
 */
class PaperTorque {
public:
    PaperTorque();

    /* Set gains, and the limits and inertia of the controller; the controller adds its joint_damping. */
    void configure(bool conventional, const double *task_stiffness, double posture_stiffness, double damping_ratio,
                   const robot::Config &controller);

    /* Begin without a torque in force. */
    void begin();

    /*
     * Compute the torque of a sample. In a fault, `faulted` is the controller's last output, and the law damps alone: q0
     * is the position, and the velocity the one that the controller believed. A wrench that the controller refuses stops
     * the law: its torque falls to zero at the rate limit.
     */
    void step(const robot::Config &controller, const robot::Input &sample, const robot::Output *faulted);

    const double *torque() const { return output_.torque; }
    const double *joint_stiffness() const { return output_.joint_stiffness; }
    double energy() const; /* [J] e^T Kq e / 2 with e = q0 - q */

private:
    robot::PaperConfig config_;
    robot::PaperState state_;
    robot::PaperInput input_;
    robot::PaperOutput output_;
};

#endif
