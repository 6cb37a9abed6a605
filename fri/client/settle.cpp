// SPDX-License-Identifier: MIT
#include "settle.h"

#include "filters.h"

#include <algorithm>

Settling::Settling(const double *force) : force_(force), settles_(false), follows_(false) {}

void Settling::begin(const robot::Config &controller)
{
    const bool wanted = force_[0] > 0.0 || force_[1] > 0.0;
    settles_ = wanted && robot::init(&controller, force_, &settle_) == 0;
    follows_ = false;
}

void Settling::step(const robot::Output *last, const double *wrench, bool hold, robot::Input *sample)
{
    if (!settles_) {
        return;
    }
    robot::SettleInput wanted;
    robot::SettleOutput moved;
    robot::pose(sample->q0, wanted.pose);
    copy(sample->translation_stiffness, wanted.translation_stiffness, 9);
    copy(sample->rotation_stiffness, wanted.rotation_stiffness, 9);
    copy(wrench, wanted.wrench, 6);
    wanted.hold = hold ? 1 : 0;
    robot::step(&settle_, &wanted, last, &moved); /* after an error the last good pose */
    const bool is_moved = std::any_of(moved.offset, moved.offset + 6, [](double part) { return part != 0.0; });
    if (is_moved && !follows_) {
        follows_ = robot::init(&settle_.controller, sample->q0, &follow_) == 0;
    }
    if (follows_) {
        robot::FollowInput target;
        robot::FollowOutput command;
        copy(moved.pose, target.pose, 16);
        copy(sample->q0, target.posture, JOINTS);
        robot::step(&follow_, &target, &command);
        copy(command.q0, sample->q0, JOINTS);
    }
}
