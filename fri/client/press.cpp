// SPDX-License-Identifier: MIT
#include "press.h"

#include <algorithm>
#include <cmath>

namespace {

/* [N] beyond the force that the springs may press more than is measured: friction, and a payload that is not known. */
const double UNKNOWN = 10.0, MOST_UNKNOWN = 50.0;

/* [s] of a search for contact beyond the way there at Press' speed. */
const double PRESS_PATIENCE = 5.0;

/* [rad/s] below which the trajectory rests. */
const double RESTING = 1e-4;

/* Share of the tip's largest distance from the trajectory by which the pose may be moved; the rest is for errors. */
const double OFFSET_SHARE = 0.5;

/* [m] farthest that the pose is moved where the distance has no limit: Press' own. */
const double FARTHEST = 0.3;

/* Return the axis along which the tip presses: the tool's z axis, out of the flange. */
void axis_of(const double *pose, double *axis)
{
    for (int i = 0; i < 3; ++i) {
        axis[i] = pose[4 * i + 2];
    }
}

/* Return what Press is asked for: a force [N] along the axis of the pose at the sample's q0, 0 for none. */
robot::PressInput question(const robot::Input &sample, const double *wrench, double force)
{
    robot::PressInput asked;
    robot::pose(sample.q0, asked.pose);
    copy(sample.translation_stiffness, asked.translation_stiffness, 9);
    copy(sample.rotation_stiffness, asked.rotation_stiffness, 9);
    axis_of(asked.pose, asked.axis);
    asked.force = force;
    if (force > 0.0) {
        copy(wrench, asked.wrench, 6);
    } else {
        fill(asked.wrench, 0.0, 6); /* without a force it may be no number */
    }
    asked.search = 0; /* a lost contact stays lost */
    return asked;
}

} // namespace

Pressing::Pressing(double force, double error_limit)
    : force_(force), offset_limit_(error_limit > 0.0 ? std::min(OFFSET_SHARE * error_limit, FARTHEST) : FARTHEST),
      presses_(false), moves_(false), rests_(false), touched_(false), end_(HELD), sought_(0.0)
{
    fill(last_, 0.0, JOINTS);
}

/* Start with the controller's configuration, before a contact is sought. */
void Pressing::begin(const robot::Config &controller)
{
    controller_ = controller;
    const double disagreement = std::min(UNKNOWN + force_, MOST_UNKNOWN);
    presses_ = wants() && robot::init(&controller, disagreement, offset_limit_, &press_) == 0;
    moves_ = rests_ = false;
    sought_ = 0.0;
    moved_.begin();
}

/* Move the sample's goal and command a wrench, so that the tip presses along its axis where the trajectory wants it. */
void Pressing::step(const robot::Output *last, const double *wrench, bool reached, bool wanted,
                    robot::Input *sample)
{
    if (!presses_) {
        return;
    }
    watch(sample->q0);
    const robot::PressInput asked = question(*sample, wrench, reached && wanted && end_ == HELD ? force_ : 0.0);
    robot::PressOutput made;
    robot::step(&press_, &asked, last, &made); /* after an error the last good pose, without a force */
    const bool is_moved = std::any_of(press_.offset, press_.offset + 3, [](double part) { return part != 0.0; });
    if (reached && end_ == HELD) { /* while the trajectory rests: Follow begins without a velocity */
        moved_.start(controller_, sample->q0);
    }
    moved_.move(made.pose, sample->q0);
    copy(made.wrench_command, sample->wrench_command, 6);
    moves_ = made.stage != robot::PRESS_OFF || is_moved;
    note(made);
}

/* Note whether the trajectory rests: from sample to sample, no joint is faster than RESTING. */
void Pressing::watch(const double *q0)
{
    rests_ = true;
    for (int i = 0; i < JOINTS; ++i) {
        rests_ = rests_ && std::fabs(q0[i] - last_[i]) <= RESTING * controller_.sample_time;
    }
    copy(q0, last_, JOINTS);
}

/* Note what became of the force; what ended it first stays. */
void Pressing::note(const robot::PressOutput &made)
{
    const double whole_way = offset_limit_ / press_.config.approach_speed; /* [s] */
    touched_ = touched_ || made.stage == robot::PRESS_CONTACT;
    sought_ = made.stage == robot::PRESS_APPROACH ? sought_ + controller_.sample_time : 0.0;
    if (end_ != HELD) {
        return;
    }
    if (sought_ > whole_way + PRESS_PATIENCE) {
        end_ = MISSED;
    } else if (made.stage == robot::PRESS_LOST) {
        end_ = LOST;
    } else if (made.stage == robot::PRESS_DOUBTED) {
        end_ = DOUBTED;
    }
}
