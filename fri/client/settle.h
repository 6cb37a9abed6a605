// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_SETTLE_H
#define FRI_CLIENT_SETTLE_H

#include "moved.h"

/*
 * Moves resting joint positions until the measured tip rests at their pose: Settle moves the pose, and Follow makes
 * joint positions of it. Until an error is integrated, the joint positions stay as they are, to the last bit.
 */
class Settling {
public:
    /* force [N, N m]: most that the springs may exert more; 0, 0: none. */
    explicit Settling(const double *force);

    /* Begin without an offset; controller: the configuration of robot::init. */
    void begin(const robot::Config &controller);

    /*
     * Move the sample's q0. last: the controller's last output, NULL before the first; wrench [N, N m] of the
     * environment at the tip; hold: the offset stays as it is.
     */
    void step(const robot::Output *last, const double *wrench, bool hold, robot::Input *sample);

    /* Return whether an offset has moved the command, and the command rests: the torque changes by Settle alone. */
    bool moves_at_rest() const { return moved_.follows() && settle_.rest > 0.0; }

private:
    const double *const force_;
    bool settles_;
    robot::Settle settle_;
    MovedPose moved_;
};

#endif
