// SPDX-License-Identifier: MIT
#ifndef FRI_ATTACK_WORLD_H
#define FRI_ATTACK_WORLD_H

/* The robot's side of a hostile session: its network, and the states of its controller. */
#include "attack_robot.h"
#include "attack_sensor.h"

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
const double LONGEST = 26.0; /* [s] after the end, after which a client that has not left never will */

class World : public Datagrams, public Robot {
public:
    World(const Schedule &schedule, const Vector &start, int period) : Robot(schedule, start, period), open_(false)
    {
        commanded_.fill(0.0);
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

    std::function<void()> watch; /* after each answer */
    ContactSensor sensor;
    double pressed = 0.0, hardest = 0.0; /* [N] on the wall: now, at most */
    double mean = 0.0, square = 0.0;     /* [N], [N^2] sums of it of the last second with torque */
    int counted = 0;                     /* cycles of these */

    std::vector<Answer> answers; /* of the present motion */
    double torque_rate[JOINTS], sample_time = 0.0; /* the client's; 0: not known yet */
    double over_limit = 0.0, step = 0.0, rate = 0.0, axis_delta = 0.0, kinetic = 0.0, fast = 0.0;
    unsigned unanswered = 0, not_finite = 0, sent = 0;
    bool idle_seen = false, interrupted = false, moved = false;
    double beyond = 0.0;  /* [rad] farthest beyond a joint's limit */
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
        } else if (!good) {
            break_off(time);
        } else if (stage_ < COMMANDING_ACTIVE && wanted > 0 && staying_ >= wanted) {
            ++stage_;
            staying_ = 0;
        }
        return stage_;
    }

    void break_off(double time)
    {
        if (stage_ > MONITORING_WAIT && schedule.at("patient", time) == NULL) {
            stage_ = MONITORING_WAIT;
            staying_ = 0;
        }
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
            const Event *const wall = schedule.at("wall", time);
            if (wall != NULL) {
                arm.wall.stand(wall->value, arm.q);
            } else {
                arm.wall.fall();
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
            note_contact(time);
        } else {
            arm.hold();
            torque_.fill(0.0);
            commanded_.fill(0.0);
            anchor_ = arm.q;
            pressed = 0.0;
        }
        sensor.measure(schedule, time, arm.q, arm.wall.force);
        last_cycle_ = now_ns;
        state_ = state;
        ++cycles_;
        counter_ += static_cast<std::uint32_t>(schedule.at("stuck", time) != NULL
                                                   ? 0
                                                   : std::llround(schedule.value("counting", time, 1.0)));
        dispatch(message(state, time), state, time);
    }

    /* Note the force on the wall; mean and square of a second that ends before the robot ends the session. */
    void note_contact(double time)
    {
        pressed = arm.wall.size;
        hardest = std::max(hardest, pressed);
        if (time > END - 1.2 && time < END - 0.2) {
            mean += pressed;
            square += pressed * pressed;
            ++counted;
        }
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

    std::vector<Parcel> parcels_;
    std::deque<std::pair<Octets, int>> sent_; /* with their states */
    std::map<std::uint32_t, int> states_; /* of the messages, by their counter */
    std::int64_t next_cycle_ = 1000000, last_cycle_ = 0;
    std::uint32_t newest_ = 0;
    bool open_, seen_any_ = false, owed_ = false;
    int stage_ = MONITORING_WAIT, staying_ = 0, complete_ = 0; /* natural state; cycles in it; commands in this cycle */
    std::deque<bool> missing_;                                 /* answers of the last cycles */
    Vector commanded_; /* received torque, in force from the next cycle on */
};

} // namespace

#endif
