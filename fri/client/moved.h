// SPDX-License-Identifier: MIT
#ifndef FRI_CLIENT_MOVED_H
#define FRI_CLIENT_MOVED_H

#include "filters.h"
#include "robot.h"

/* Joint positions of a pose that was moved from theirs, by Follow. It begins at rest, where a pose is moved first. */
class MovedPose {
public:
    MovedPose() : follows_(false) {}

    void begin() { follows_ = false; }
    bool follows() const { return follows_; }

    /* Let Follow begin at joint positions that are at rest; controller: the configuration of robot::init. */
    void start(const robot::Config &controller, const double *q0)
    {
        follows_ = follows_ || robot::init(&controller, q0, &follow_) == 0;
    }

    /* Change joint positions to those of the pose, if Follow has begun. */
    void move(const double *pose, double *q0)
    {
        if (!follows_) {
            return;
        }
        robot::FollowInput target;
        robot::FollowOutput command;
        copy(pose, target.pose, 16);
        copy(q0, target.posture, JOINTS);
        robot::step(&follow_, &target, &command);
        copy(command.q0, q0, JOINTS);
    }

private:
    bool follows_;
    robot::Follow follow_;
};

#endif
