// SPDX-License-Identifier: MIT
#ifndef FRI_ATTACK_WORLD_H
#define FRI_ATTACK_WORLD_H

/* The robot's side of a hostile session: network, controller and arm. */
#include "attack_arm.h"

namespace {

/* ---- the world --------------------------------------------------------------------------------------------------- */

/* A datagram on its way to the client. */
struct Parcel {
    Octets bytes;
    std::int64_t arrival;
    std::uint32_t sequence;
    int state, multiplier;
    bool sound, whole; /* to be answered; as it was sent, if late or again */
};

/* An answer that went out in COMMANDING_ACTIVE. */
struct Answer {
    double time;
    Vector torque;
};

double END = 4.0;            /* [s] after which the robot has ended the session, and is silent */
const double PARTED = 0.02;  /* [rad] */
const double LATEST = 0.06;  /* [s] from there to letting go */
const double LONGEST = 26.0; /* [s] after the end, after which a client that has not left never will */

class World : public Datagrams {
public:
    World(const Schedule &schedule, const Vector &start, int period)
        : schedule(schedule), arm(start), period_(period), random_(schedule.seed), open_(false)
    {
        torque_.fill(0.0);
        commanded_.fill(0.0);
        anchor_ = start;
    }

    bool open(int, const char *) override { return open_ = true; }
    void close() override { open_ = false; }
    bool is_open() const override { return open_; }

    int receive(std::uint8_t *bytes, std::size_t capacity, double wait, double *age) override
    {
        if (wait > 0.0) {
            unanswered += owed_ ? 1 : 0;
            owed_ = false;
        }
        const Event *const stop = due_stop(0.0);
        if (stop != NULL) {
            pass(std::llround(1e9 * stop->length));
        }
        pass(3000);
        const std::int64_t until = now_ns + std::llround(1e9 * std::max(wait, 0.0));
        for (;;) {
            const Event *const person = schedule.due("interrupt", seconds());
            if (person != NULL) {
                interrupts = interrupts + static_cast<int>(person->value);
                interrupted = true;
                if (wait > 0.0) {
                    return SIGNALLED;
                }
            }
            const auto first = std::min_element(parcels_.begin(), parcels_.end(), [](const Parcel &a, const Parcel &b) {
                return a.arrival < b.arrival;
            });
            if (first != parcels_.end() && first->arrival <= now_ns) {
                const Parcel parcel = *first;
                parcels_.erase(first);
                *age = 1e-9 * static_cast<double>(now_ns - parcel.arrival);
                std::copy_n(parcel.bytes.begin(), std::min(parcel.bytes.size(), capacity), bytes);
                see(parcel);
                return static_cast<int>(parcel.bytes.size());
            }
            if (now_ns >= until) {
                return -1;
            }
            std::int64_t next = std::min(next_cycle_, until);
            next = first != parcels_.end() ? std::min(next, first->arrival) : next;
            pass(std::max<std::int64_t>(next - now_ns, 0));
        }
    }

    bool send(const std::uint8_t *bytes, std::size_t size) override
    {
        const Event *const stop = due_stop(1.0);
        if (stop != NULL) {
            pass(std::llround(1e9 * stop->length));
        }
        pass(20000);
        owed_ = false;
        const std::size_t front = FRI_VERSION >= 207 ? 4 : 0;
        const Part body = {bytes + front, size - 2 * front};
        std::uint64_t answered = 0;
        field(field(body, 1), 3, &answered);
        const int state = states_[static_cast<std::uint32_t>(answered)];
        if (state != COMMANDING_ACTIVE || last_state != COMMANDING_ACTIVE) {
            answers.clear(); /* a motion begins with torque zero */
        }
        last_state = state;
        const Part command = field(body, 2);
        Vector position, torque;
        if (take_joints(field(command, 1), &position) && take_joints(field(command, 3), &torque)) {
            take(position, torque);
        }
        if (watch) {
            watch();
        }
        return true;
    }

    Schedule schedule;
    Arm arm;
    std::function<void()> watch; /* after each answer */

    std::vector<Answer> answers; /* of the present motion */
    double over_limit = 0.0, step = 0.0, rate = 0.0, axis_delta = 0.0, kinetic = 0.0, fast = 0.0;
    double effort[JOINTS], torque_rate[JOINTS], sample_time = 0.0; /* the client's; 0: not known yet */
    int multiplier = 1;
    unsigned unanswered = 0, not_finite = 0, sent = 0;
    bool idle_seen = false, interrupted = false, moved = false;
    double beyond = 0.0;  /* [rad] farthest beyond a joint's limit */
    double apart = 0.0;   /* [rad] of the arm now from its measured position */
    double parted = -1.0; /* [s] when a joint was PARTED from its measured position; -1: never */
    int parted_joint = -1;
    Vector held = Vector(); /* share of the effort limit that friction held, if positions that stand still were true */
    double last_torque = 0.0, last_delivery = 0.0, gap = 0.0; /* largest [N m] of the last answer; [s] */
    std::deque<double> deliveries;                            /* [s] of the last sound messages */
    int last_state = IDLE;                                    /* of the last message that was answered */

private:
    const Event *due_stop(double where)
    {
        const auto found = schedule.events.find("stop");
        if (found == schedule.events.end()) {
            return NULL;
        }
        for (Event &event : found->second) {
            if (!event.done && seconds() >= event.start && (event.value >= 0.5) == (where >= 0.5)) {
                event.done = true;
                return &event;
            }
        }
        return NULL;
    }

    /* Time goes by, and the robot with it. */
    void pass(std::int64_t duration)
    {
        const std::int64_t until = now_ns + duration;
        while (next_cycle_ <= until) {
            now_ns = std::max(now_ns, next_cycle_);
            cycle();
            const double slow = schedule.value("slow", seconds(), 1.0);
            next_cycle_ += std::llround(1e6 * period_ * std::max(slow, 0.05));
        }
        now_ns = until;
        if (seconds() > END + LONGEST) {
            throw std::runtime_error("the client does not end");
        }
    }

    /* A datagram reaches the client. */
    void see(const Parcel &parcel)
    {
        idle_seen = idle_seen || (parcel.whole && parcel.state == IDLE);
        if (!parcel.sound || (seen_any_ && (parcel.sequence == newest_ || parcel.sequence - newest_ > 1u << 20))) {
            return; /* an old one, or an old counter */
        }
        newest_ = parcel.sequence;
        seen_any_ = true;
        owed_ = parcel.state != IDLE && parcel.multiplier == 1;
        deliveries.push_back(seconds());
        if (deliveries.size() > 1000) {
            deliveries.pop_front();
        }
    }

    /* An answer of the client with position and torque. */
    void take(const Vector &position, const Vector &torque)
    {
        ++sent;
        const double time = seconds();
        last_torque = 0.0;
        for (std::size_t i = 0; i < JOINTS; ++i) {
            not_finite += std::isfinite(torque[i]) && std::isfinite(position[i]) ? 0 : 1;
            over_limit = std::max(over_limit, std::fabs(torque[i]) / effort[i]);
            last_torque = std::max(last_torque, std::fabs(torque[i]));
            axis_delta = std::max(axis_delta, std::fabs(position[i] - arm.q[i]));
        }
        moved = moved || last_torque > 0.0;
        if (last_state == COMMANDING_ACTIVE) {
            const double period = sample_time;
            for (std::size_t i = 0; i < JOINTS; ++i) {
                const double before = answers.empty() ? 0.0 : answers.back().torque[i];
                step = std::max(step, std::fabs(torque[i] - before) / (torque_rate[i] * period * multiplier));
                for (std::size_t k = answers.size() > 60 ? answers.size() - 60 : 0; k < answers.size(); ++k) {
                    const double allowed = torque_rate[i] * (time - answers[k].time + 2.0 * period);
                    rate = std::max(rate, std::fabs(torque[i] - answers[k].torque[i]) / allowed);
                }
            }
            answers.push_back(Answer{time, torque});
        }
        if (uniform_(random_) >= schedule.value("deaf", time, 0.0)) {
            commanded_ = torque;
            complete_ += 1;
        }
    }

    /* State as the robot has it by itself: more than five answers of a hundred missing break the motion off, unless it
     * is patient; then it begins again. */
    int natural_state(double time)
    {
        const bool good = std::count(missing_.begin(), missing_.end(), true) <= 5;
        missing_.push_back(complete_ == 0 && stage_ >= COMMANDING_WAIT);
        if (missing_.size() > 100) {
            missing_.pop_front();
        }
        const int wanted = stage_ == COMMANDING_WAIT ? 5 * (complete_ > 0) : 5;
        ++staying_;
        complete_ = 0;
        if (time > END - 0.1) {
            stage_ = time > END ? IDLE : MONITORING_READY;
        } else if (stage_ > MONITORING_WAIT && !good && schedule.at("patient", time) == NULL) {
            stage_ = MONITORING_WAIT;
            staying_ = 0;
        } else if (stage_ < COMMANDING_ACTIVE && good && wanted > 0 && staying_ >= wanted) {
            ++stage_;
            staying_ = 0;
        }
        return stage_;
    }

    /* One of the robot's cycles: the arm moves, then a message. */
    void cycle()
    {
        const double time = seconds();
        if (schedule.at("silence", time) != NULL || time > END + 0.5) {
            return;
        }
        const int state = static_cast<int>(schedule.value("state", time, natural_state(time)));
        if (state == COMMANDING_ACTIVE && state_ == COMMANDING_ACTIVE) {
            Vector push;
            std::array<bool, JOINTS> blocked;
            push.fill(0.0);
            blocked.fill(schedule.at("held", time) != NULL);
            const Event *const joint = schedule.at("blocked", time), *const hand = schedule.at("push", time);
            if (joint != NULL) {
                blocked[static_cast<std::size_t>(static_cast<int>(joint->value) % JOINTS)] = true;
            }
            if (hand != NULL) {
                push[static_cast<std::size_t>(joint_of(*hand))] = hand->value;
            }
            arm.motor = schedule.value("motor", time, 0.2);
            for (int i = 0; i < JOINTS; ++i) {
                arm.dry[static_cast<std::size_t>(i)] = schedule.value("sticky", time, 0.0) * effort[i];
            }
            const double elapsed = std::min(1e-9 * static_cast<double>(now_ns - last_cycle_), 0.1);
            const int count = std::max(1, static_cast<int>(std::lround(elapsed / 0.00025)));
            for (int k = 0; k < count; ++k) {
                arm.step(torque_, push, blocked, elapsed / count);
                kinetic = std::max(kinetic, arm.kinetic);
                for (int i = 0; i < JOINTS; ++i) {
                    const double q = arm.q[static_cast<std::size_t>(i)];
                    fast = std::max(fast, std::fabs(arm.dq[static_cast<std::size_t>(i)]) / robot::velocity(i));
                    beyond = std::max(beyond, std::max(q - robot::upper(i), robot::lower(i) - q));
                }
            }
            torque_ = commanded_;
        } else {
            arm.hold();
            torque_.fill(0.0);
            commanded_.fill(0.0);
            anchor_ = arm.q;
        }
        last_cycle_ = now_ns;
        state_ = state;
        ++cycles_;
        counter_ += static_cast<std::uint32_t>(schedule.at("stuck", time) != NULL
                                                   ? 0
                                                   : std::llround(schedule.value("counting", time, 1.0)));
        dispatch(message(state, time), state, time);
    }

    Octets message(int state, double time)
    {
        const int without = static_cast<int>(schedule.value("without", time, 0.0));
        const bool commanding = state >= COMMANDING_WAIT;
        sequence_ = counter_ + static_cast<std::uint32_t>(std::llround(schedule.value("counter", time, 0.0)));
        multiplier = static_cast<int>(schedule.value("multiplier", time, 1.0));
        Octets body, header, states, measured, connection, interpolator, stamp;
        put(&header, 1, 0x245142u);
        put(&header, 2, sequence_);
        put(&header, 3, 0u);
        put(&body, 1, header);
        put(&states, 1, 7u);
        put(&states, 2, choice("safety", time, 0.0));
        for (int i = 0; i < JOINTS; ++i) {
            put(&states, 5, choice("drives", time, 2.0));
        }
        put(&states, 6, choice("operation", time, 2.0));
        put(&states, 7, 2u);
        if ((without & 8) == 0) {
            put(&body, 2, states);
        }
        Vector q = arm.q, external = arm.external;
        const Event *const off = schedule.at("offset", time), *const broken = schedule.at("nan", time);
        const double noise = schedule.value("noise", time, 0.0), gain = schedule.value("gain", time, 1.0);
        for (std::size_t i = 0; i < JOINTS; ++i) {
            q[i] += noise * (2.0 * uniform_(random_) - 1.0);
        }
        if (off != NULL) {
            q[static_cast<std::size_t>(joint_of(*off))] += off->value;
        }
        if (broken != NULL) {
            q[static_cast<std::size_t>(static_cast<int>(broken->value) % JOINTS)] = std::nan("");
        }
        deceive(time, &q, &external);
        const double hum = schedule.value("hum", time, 0.0);
        const double bias = schedule.value("bias", time, 0.0);
        for (std::size_t i = 0; i < JOINTS; ++i) {
            external[i] = gain * external[i] + (hum > 0.0 ? hum * (2.0 * uniform_(random_) - 1.0) : 0.0);
            external[i] += (i % 2 == 0 ? bias : -bias) * effort[i];
        }
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
        Octets io;
        const std::string name = BUTTON;
        put(&io, 1, Octets(name.begin(), name.end()));
        put(&io, 2, 0u);
        put(&io, 3, 0u);
        put(&io, 4, schedule.at("button", time) != NULL ? 1u : 0u);
        put(&measured, 8, io);
        std::int64_t told = EPOCH + now_ns + std::llround(1e9 * schedule.value("clock", time, 0.0));
        told += std::llround(1e6 * period_ * schedule.value("jitter", time, 0.0)) * (cycles_ % 2 == 0 ? 1 : -1);
        const std::int64_t coarse = std::max<std::int64_t>(1, std::llround(1e9 * schedule.value("coarse", time, 0.0)));
        told -= told % coarse;
        told_ = schedule.at("frozen", time) != NULL ? told_ : told;
        put(&stamp, 1, static_cast<std::uint64_t>(told_ / 1000000000));
        put(&stamp, 2, static_cast<std::uint64_t>(told_ % 1000000000));
        if ((without & 16) == 0) {
            put(&measured, 15, stamp);
        }
        if ((without & 32) == 0) {
            put(&body, 3, measured);
        }
        put(&connection, 1, static_cast<std::uint64_t>(state));
        put(&connection, 2, choice("quality", time, 3.0));
        put(&connection, 3, choice("period", time, period_));
        put(&connection, 4, static_cast<std::uint64_t>(multiplier));
        put(&body, 4, connection);
        if (commanding && (without & 4) == 0) {
            put_reals(&interpolator, 1, anchor_.data(), JOINTS);
            put(&interpolator, 10, choice("mode", time, 3.0));
            put(&interpolator, 11, 1u);
            put(&body, 5, interpolator);
        }
        /* Whether the client has to answer it. */
        whole_ = (without & 32) == 0 && ((without & 4) == 0 || !commanding);
        return framed(body);
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
        const int toggling = static_cast<int>(schedule.value("toggling", time, 0.0));
        const int late = static_cast<int>(schedule.value("late", time, 0.0));
        const std::size_t back = std::min<std::size_t>(static_cast<std::size_t>(late % 10000), measured_.size() - 1);
        for (std::size_t i = 0; i < JOINTS; ++i) {
            const bool stuck = stands(i, time);
            (*q)[i] = stuck ? stood_[i] : (*q)[i];
            stood_[i] = (*q)[i];
            if ((toggling / 100 >> i & 1) != 0 && cycles_ % 2 == 0) {
                std::uint64_t bits;
                std::memcpy(&bits, &(*q)[i], sizeof bits);
                bits ^= std::uint64_t(1) << (toggling % 100);
                std::memcpy(&(*q)[i], &bits, sizeof bits);
            }
            (*q)[i] = (late / 10000 >> i & 1) != 0 ? measured_[measured_.size() - 1 - back][i] : (*q)[i];
            if (stuck && schedule.at("misled", time) != NULL) {
                (*external)[i] = schedule.value("misled", time, 0.0) > 1.5 ? -arm.sensed[i] : -torque_[i];
            }
            apart = std::max(i > 0 ? apart : 0.0, std::fabs(arm.q[i] - (*q)[i]));
            if (parted < 0.0 && std::fabs(arm.q[i] - (*q)[i]) >= PARTED && state_ == COMMANDING_ACTIVE) {
                parted = time;
                parted_joint = static_cast<int>(i);
            }
        }
    }

    std::uint64_t choice(const char *kind, double time, double otherwise) const
    {
        return static_cast<std::uint64_t>(std::llround(std::max(0.0, schedule.value(kind, time, otherwise))));
    }

    /* What becomes of a message on its way. */
    void dispatch(const Octets &bytes, int state, double time)
    {
        sent_.push_back(std::make_pair(bytes, state));
        states_[sequence_] = state;
        if (uniform_(random_) < schedule.value("drop", time, 0.0)) {
            return;
        }
        Parcel parcel = {bytes, now_ns + 50000, sequence_, state, multiplier, whole_, true};
        const Event *const burst = schedule.at("burst", time), *const cut = schedule.at("cut", time);
        parcel.arrival += std::llround(1e9 * std::max(0.0, schedule.value("delay", time, 0.0)) * uniform_(random_));
        if (burst != NULL) {
            parcel.arrival = std::llround(1e9 * (burst->start + burst->length));
        }
        if (uniform_(random_) < schedule.value("garbage", time, 0.0)) {
            parcel.sound = parcel.whole = false;
            parcel.bytes.resize(1 + static_cast<std::size_t>(1498.0 * uniform_(random_)));
            for (std::uint8_t &byte : parcel.bytes) {
                byte = static_cast<std::uint8_t>(random_());
            }
        } else if (cut != NULL) {
            parcel.sound = parcel.whole = false;
            parcel.bytes.resize(static_cast<std::size_t>(
                std::min(std::max(cut->value, 0.0), 0.99) * static_cast<double>(bytes.size())));
        }
        parcels_.push_back(parcel);
        parcel.sound = false;
        if (uniform_(random_) < schedule.value("twice", time, 0.0)) {
            parcel.arrival += std::llround(1e6 * period_ * 3.0 * uniform_(random_));
            parcels_.push_back(parcel);
        }
        const double back = schedule.value("replay", time, 0.0);
        if (back >= 1.0 && sent_.size() > static_cast<std::size_t>(back)) {
            const std::size_t which = sent_.size() - 1 - static_cast<std::size_t>(back);
            parcel.bytes = sent_[which].first;
            parcel.state = sent_[which].second;
            parcel.whole = true;
            parcel.arrival += 1000;
            parcels_.push_back(parcel);
        }
    }

    const double period_; /* [ms] */
    std::mt19937 random_;
    std::uniform_real_distribution<double> uniform_{0.0, 1.0};
    std::vector<Parcel> parcels_;
    std::deque<std::pair<Octets, int>> sent_; /* with their states */
    std::map<std::uint32_t, int> states_; /* of the messages, by their counter */
    std::int64_t next_cycle_ = 1000000, last_cycle_ = 0, told_ = EPOCH;
    std::uint32_t counter_ = 0, sequence_ = 0, newest_ = 0;
    bool open_, seen_any_ = false, owed_ = false, whole_ = true;
    int cycles_ = 0, state_ = IDLE;
    int stage_ = MONITORING_WAIT, staying_ = 0, complete_ = 0; /* natural state; cycles in it; commands in this cycle */
    std::deque<bool> missing_;                                 /* answers of the last cycles */
    std::vector<Vector> measured_;                             /* positions before the faults of their encoders */
    Vector stood_ = Vector();                                  /* position that a joint is to stand at */
    Vector torque_, commanded_, anchor_; /* in force; received, in force from the next cycle on; interpolator's */
};

} // namespace

#endif
