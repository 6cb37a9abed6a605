// SPDX-License-Identifier: MIT
#ifndef FRI_ATTACK_ROBOT_H
#define FRI_ATTACK_ROBOT_H

/* A hostile robot: its arm, and the messages that it writes about it. */
#include "attack_arm.h"

namespace {

const double PARTED = 0.02; /* [rad] */
const double LATEST = 0.06; /* [s] from there to letting go */

/* Measures and writes what its schedule says. */
class Robot {
public:
    Schedule schedule;
    Arm arm;
    double effort[JOINTS]; /* [N m] the client's limits */
    int multiplier = 1;
    double apart = 0.0;   /* [rad] of the arm now from its measured position */
    double parted = -1.0; /* [s] when a joint was PARTED from its measured position; -1: never */
    int parted_joint = -1;
    Vector held = Vector(); /* share of the effort limit that friction held, if positions that stand still were true */

protected:
    Robot(const Schedule &schedule, const Vector &start, int period)
        : schedule(schedule), arm(start), period_(period), random_(schedule.seed), anchor_(start)
    {
        torque_.fill(0.0);
    }

    Octets message(int state, double time)
    {
        const int without = static_cast<int>(schedule.value("without", time, 0.0));
        const bool commanding = state >= COMMANDING_WAIT;
        sequence_ = counter_ + static_cast<std::uint32_t>(std::llround(schedule.value("counter", time, 0.0)));
        multiplier = static_cast<int>(schedule.value("multiplier", time, 1.0));
        Octets body, header;
        put(&header, 1, 0x245142u);
        put(&header, 2, sequence_);
        put(&header, 3, 0u);
        put(&body, 1, header);
        if ((without & 8) == 0) {
            put(&body, 2, robot_states(time));
        }
        const Octets measured = measurement(time, without);
        if ((without & 32) == 0) {
            put(&body, 3, measured);
        }
        put(&body, 4, connection(state, time));
        if (commanding && (without & 4) == 0) {
            put(&body, 5, interpolator(time));
        }
        /* Whether the client has to answer it. */
        whole_ = (without & 32) == 0 && ((without & 4) == 0 || !commanding);
        return framed(body);
    }

    Octets robot_states(double time) const
    {
        Octets states;
        put(&states, 1, 7u);
        put(&states, 2, choice("safety", time, 0.0));
        for (int i = 0; i < JOINTS; ++i) {
            put(&states, 5, choice("drives", time, 2.0));
        }
        put(&states, 6, choice("operation", time, 2.0));
        put(&states, 7, 2u);
        return states;
    }

    Octets connection(int state, double time) const
    {
        Octets connection;
        put(&connection, 1, static_cast<std::uint64_t>(state));
        put(&connection, 2, choice("quality", time, 3.0));
        put(&connection, 3, choice("period", time, period_));
        put(&connection, 4, static_cast<std::uint64_t>(multiplier));
        return connection;
    }

    Octets interpolator(double time) const
    {
        Octets interpolator;
        put_reals(&interpolator, 1, anchor_.data(), JOINTS);
        put(&interpolator, 10, choice("mode", time, 3.0));
        put(&interpolator, 11, 1u);
        return interpolator;
    }

    /* Measured positions, with their faults. */
    Vector positions(double time)
    {
        Vector q = arm.q;
        const Event *const off = schedule.at("offset", time), *const broken = schedule.at("nan", time);
        const double noise = schedule.value("noise", time, 0.0);
        for (std::size_t i = 0; i < JOINTS; ++i) {
            q[i] += noise * (2.0 * uniform_(random_) - 1.0);
        }
        if (off != NULL) {
            q[static_cast<std::size_t>(joint_of(*off))] += off->value;
        }
        if (broken != NULL) {
            q[static_cast<std::size_t>(static_cast<int>(broken->value) % JOINTS)] = std::nan("");
        }
        return q;
    }

    /* Add gain, noise and offset of the external torques. */
    void disturb(double time, Vector *external)
    {
        const double hum = schedule.value("hum", time, 0.0), bias = schedule.value("bias", time, 0.0);
        const double gain = schedule.value("gain", time, 1.0);
        for (std::size_t i = 0; i < JOINTS; ++i) {
            double &torque = (*external)[i];
            torque = gain * torque + (hum > 0.0 ? hum * (2.0 * uniform_(random_) - 1.0) : 0.0);
            torque += (i % 2 == 0 ? bias : -bias) * effort[i];
        }
    }

    Octets measurement(double time, int without)
    {
        Octets measured;
        Vector q = positions(time), external = arm.external;
        deceive(time, &q, &external);
        disturb(time, &external);
        note_held(time, external);
        if ((without & 1) == 0) {
            put_reals(&measured, 1, q.data(), JOINTS);
        }
        put_reals(&measured, 2, arm.sensed.data(), JOINTS);
        if (FRI_VERSION < 200) {
            put_reals(&measured, 3, q.data(), JOINTS);
        }
        put_reals(&measured, 4, torque_.data(), JOINTS);
        if ((without & 2) == 0) {
            put_reals(&measured, 5, external.data(), JOINTS);
        }
        put(&measured, 8, button(time));
        const Octets stamp = time_stamp(time);
        if ((without & 16) == 0) {
            put(&measured, 15, stamp);
        }
        return measured;
    }

    Octets button(double time) const
    {
        Octets io;
        const std::string name = BUTTON;
        put(&io, 1, Octets(name.begin(), name.end()));
        put(&io, 2, 0u);
        put(&io, 3, 0u);
        put(&io, 4, schedule.at("button", time) != NULL ? 1u : 0u);
        return io;
    }

    Octets time_stamp(double time)
    {
        Octets stamp;
        std::int64_t told = EPOCH + now_ns + std::llround(1e9 * schedule.value("clock", time, 0.0));
        told += std::llround(1e6 * period_ * schedule.value("jitter", time, 0.0)) * (cycles_ % 2 == 0 ? 1 : -1);
        const std::int64_t coarse = std::max<std::int64_t>(1, std::llround(1e9 * schedule.value("coarse", time, 0.0)));
        told -= told % coarse;
        told_ = schedule.at("frozen", time) != NULL ? told_ : told;
        put(&stamp, 1, static_cast<std::uint64_t>(told_ / 1000000000));
        put(&stamp, 2, static_cast<std::uint64_t>(told_ % 1000000000));
        return stamp;
    }

    /* Note the torque that friction must hold if the positions that stand still are true, until it is too late. */
    void note_held(double time, const Vector &external)
    {
        if (state_ != COMMANDING_ACTIVE || (parted >= 0.0 && time > parted + LATEST)) {
            return;
        }
        for (std::size_t i = 0; i < JOINTS; ++i) {
            const double share = std::fabs(torque_[i] + external[i]) / effort[i];
            held[i] = stands(i, time) ? std::max(held[i], share) : held[i];
        }
    }

    bool stands(std::size_t joint, double time) const
    {
        const int still = static_cast<int>(schedule.value("still", time, 0.0));
        const int toggling = static_cast<int>(schedule.value("toggling", time, 0.0));
        return ((still | toggling / 100) >> joint & 1) != 0;
    }

    /* Replace positions by those of faulty encoders, and note how far the arm is from them. */
    void deceive(double time, Vector *q, Vector *external)
    {
        const double quantum = schedule.value("quantum", time, 0.0);
        for (std::size_t i = 0; quantum > 0.0 && i < JOINTS; ++i) {
            (*q)[i] = quantum * std::nearbyint((*q)[i] / quantum);
        }
        measured_.push_back(*q);
        const int late = static_cast<int>(schedule.value("late", time, 0.0));
        const std::size_t back = std::min<std::size_t>(static_cast<std::size_t>(late % 10000), measured_.size() - 1);
        for (std::size_t i = 0; i < JOINTS; ++i) {
            stand(i, time, &(*q)[i], &(*external)[i]);
            (*q)[i] = (late / 10000 >> i & 1) != 0 ? measured_[measured_.size() - 1 - back][i] : (*q)[i];
            note_apart(i, time, std::fabs(arm.q[i] - (*q)[i]));
        }
    }

    /* Let the position of a joint stand still if it is to, with a bit that toggles, and with an external torque that
     * believes it. */
    void stand(std::size_t i, double time, double *q, double *external)
    {
        const int toggling = static_cast<int>(schedule.value("toggling", time, 0.0));
        const bool stuck = stands(i, time);
        *q = stuck ? stood_[i] : *q;
        stood_[i] = *q;
        if ((toggling / 100 >> i & 1) != 0 && cycles_ % 2 == 0) {
            std::uint64_t bits;
            std::memcpy(&bits, q, sizeof bits);
            bits ^= std::uint64_t(1) << (toggling % 100);
            std::memcpy(q, &bits, sizeof bits);
        }
        if (stuck && schedule.at("misled", time) != NULL) {
            *external = schedule.value("misled", time, 0.0) > 1.5 ? -arm.sensed[i] : -torque_[i];
        }
    }

    /* Note how far joint i is from its measured position [rad]. */
    void note_apart(std::size_t i, double time, double distance)
    {
        apart = std::max(i > 0 ? apart : 0.0, distance);
        if (parted < 0.0 && distance >= PARTED && state_ == COMMANDING_ACTIVE) {
            parted = time;
            parted_joint = static_cast<int>(i);
        }
    }

    std::uint64_t choice(const char *kind, double time, double otherwise) const
    {
        return static_cast<std::uint64_t>(std::llround(std::max(0.0, schedule.value(kind, time, otherwise))));
    }

    const double period_; /* [ms] */
    std::mt19937 random_;
    std::uniform_real_distribution<double> uniform_{0.0, 1.0};
    std::uint32_t counter_ = 0, sequence_ = 0;
    bool whole_ = true; /* the client has to answer the message */
    int cycles_ = 0, state_ = IDLE;
    Vector torque_, anchor_; /* in force; interpolator's position */

private:
    std::int64_t told_ = EPOCH;
    std::vector<Vector> measured_; /* positions before the faults of their encoders */
    Vector stood_ = Vector();      /* position that a joint is to stand at */
};

} // namespace

#endif
