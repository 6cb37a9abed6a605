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

    /* Set gains, and the limits and inertia of the controller. */
    void configure(bool conventional, const double *task_stiffness, double posture_stiffness, double damping_ratio,
                   const robot::Config &controller);

    /* Begin without a torque in force. */
    void begin();

    /*
     * Compute the torque of a sample. In a fault of the controller the law damps alone: q0 is the position. A wrench
     * above 500 N or 100 N m, or none, stops the law: its torque falls to zero at the rate limit.
     */
    void step(double sample_time, const robot::Input &sample, const double *wrench, bool faulted);

    const double *torque() const { return output_.torque; }
    double energy() const; /* [J] e^T Kq e / 2 with e = q0 - q */

private:
    robot::PaperConfig config_;
    robot::PaperState state_;
    robot::PaperInput input_;
    robot::PaperOutput output_;
};

#endif
