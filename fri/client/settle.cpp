// SPDX-License-Identifier: MIT
#include "settle.h"

#include <algorithm>

Settling::Settling(const double *force) : force_(force), settles_(false) {}

void Settling::begin(const robot::Config &controller)
{
    const bool wanted = force_[0] > 0.0 || force_[1] > 0.0;
    settles_ = wanted && robot::init(&controller, force_, &settle_) == 0;
    moved_.begin();
}

/* Move the sample's goal so that the tip rests at its pose in spite of friction; hold: the offset stays as it is. */
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
    if (is_moved) {
        moved_.start(settle_.controller, sample->q0);
    }
    moved_.move(moved.pose, sample->q0);
}
