// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_PRESS_H
#define FRI_CLIENT_PRESS_H

#include "moved.h"

/*
 * Holds a force along the tool's z axis of the trajectory's pose: Press moves the pose and makes a wrench_command, and
 * Follow makes joint positions of the pose. Until the arm has reached the trajectory they stay as they are, to the last
 * bit. A force that was lost or doubted is not looked for again: the pose goes back, for the rest of the session.
 */
class Pressing {
public:
    /* What ended the force: lost contact, springs that say more than the sensor, a frozen sensor, nothing to touch. */
    enum End { HELD, LOST, DOUBTED, FROZEN, MISSED };

    /* force [N] to hold, 0: none; error_limit [m]: of the pace, 0: none. The pose is moved by half of it at most. */
    Pressing(double force, double error_limit);

    /* Begin without a move of the pose; controller: the configuration of robot::init. */
    void begin(const robot::Config &controller);

    /*
     * Move the sample's q0, and set its wrench_command. last: the controller's last output, NULL before the first;
     * wrench [N, N m] of the environment at the tip; reached: the arm has come to the trajectory, where it was at rest;
     * wanted: and nothing lets the force go.
     */
    void step(const robot::Output *last, const double *wrench, bool reached, bool wanted, robot::Input *sample);

    /* The sensor's reading stands still: end the force. */
    void doubt() { end_ = end_ == HELD ? FROZEN : end_; }

    bool wants() const { return force_ > 0.0; }
    bool moves_at_rest() const { return moves_ && rests_; } /* the trajectory rests: Press alone changes the torque */
    bool touched() const { return touched_; } /* the force was held at some time */
    End end() const { return end_; }

private:
    void note(const robot::PressOutput &made);
    void watch(const double *q0);

    const double force_, offset_limit_;
    bool presses_, moves_, rests_, touched_;
    End end_;
    double sought_;       /* [s] of this search for contact */
    double last_[JOINTS]; /* [rad] of the trajectory */
    robot::Config controller_;
    robot::Press press_;
    MovedPose moved_;
};

#endif
