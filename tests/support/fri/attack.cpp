// SPDX-License-Identifier: MIT
/*
 * Sessions of the client with a hostile robot, in one process and in a time of their own: a virtual clock, network and
 * arm. Reads schedules from stdin, one a line, and prints what each came to as a line of JSON.
 *
 *   attack TRAJECTORY PERIOD_MS
 *
 * A schedule is "SEED [KIND START LENGTH VALUE]...": what the robot, the network, this machine or the person does, from a
 * time [s] since the first message, for so long [s]. KIND is a name of KINDS. tests/campaigns/attack_fri.py makes and mutates
 * them.
 */
#include "session.h"

#include "checksum.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <deque>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <random>
#include <sstream>
#include <stdexcept>

namespace {

std::int64_t now_ns = 0; /* [ns] of the virtual clock, both monotonic and real */
volatile std::sig_atomic_t interrupts = 0;

double seconds()
{
    return 1e-9 * static_cast<double>(now_ns);
}

const std::int64_t EPOCH = 1700000000000000000; /* [ns] Unix time at which it starts */

} // namespace

extern "C" void ROBOT_MASS_MATRIX(const double *q, double *mass_matrix);

/* In place of the C library's. */
extern "C" int clock_gettime(clockid_t, struct timespec *time) noexcept
{
    const std::int64_t told = EPOCH + now_ns;
    time->tv_sec = told / 1000000000;
    time->tv_nsec = told % 1000000000;
    return 0;
}

namespace {

enum { IDLE, MONITORING_WAIT, MONITORING_READY, COMMANDING_WAIT, COMMANDING_ACTIVE };

/* What may be done. The value's meaning is in the comment. */
const char *const KINDS[] = {
    /* network */
    "drop",     /* share of the robot's messages lost */
    "deaf",     /* share of the client's answers lost */
    "delay",    /* [s] at most, of each message another one */
    "burst",    /* messages wait until the end, then come in their order */
    "twice",    /* share of messages that come twice */
    "replay",   /* messages so many before come again */
    "garbage",  /* share of messages that are random bytes */
    "cut",      /* share of the bytes that is left */
    /* what the robot says */
    "state", "quality", "safety", "drives", "operation", "mode", "period", "multiplier", /* this value */
    "clock",    /* [s] its clock is off */
    "jitter",   /* share of a period that it is off, to and fro */
    "coarse",   /* [s] its resolution */
    "frozen",   /* it stands still */
    "counter",  /* the sequence counter is off by so many */
    "counting", /* it grows by so many a message */
    "stuck",    /* it stands still */
    "without",  /* parts left out: 1 position, 2 external torque, 4 interpolator, 8 robot's states, 16 time, 32 measurement */
    "nan",      /* position of this joint */
    "offset",   /* [rad] of the position of joint 0 to 6, by the START's microseconds */
    "noise",    /* [rad] of the positions */
    "gain",     /* of the external torque */
    "button",   /* pressed */
    /* what happens to the arm */
    "held",     /* it does not move */
    "blocked",  /* this joint does not move */
    "push",     /* [N m] on joint 0 to 6, by the START's microseconds */
    "silence",  /* the robot does nothing */
    "slow",     /* its periods take so many times as long */
    "patient",  /* it never breaks a motion off for missing answers, and holds the last torque */
    /* this machine, and the person */
    "stop",     /* the client stands still, for LENGTH, before it receives (0) or in its callback (1) */
    "interrupt", /* Ctrl-C; so many times */
    "answer",   /* to the question: 1 yes, 0 no */
};
enum { KIND_COUNT = sizeof KINDS / sizeof *KINDS };

struct Event {
    double start, length, value;
    bool done;
};

struct Schedule {
    unsigned seed;
    std::map<std::string, std::vector<Event>> events;

    explicit Schedule(const std::string &line) : seed(0)
    {
        std::istringstream stream(line);
        std::string kind;
        stream >> seed;
        while (stream >> kind) {
            Event event = {0.0, 0.0, 0.0, false};
            const bool known = std::any_of(KINDS, KINDS + KIND_COUNT, [&](const char *name) { return kind == name; });
            if (!(stream >> event.start >> event.length >> event.value) || !known) {
                throw std::runtime_error("schedule: " + kind);
            }
            events[kind].push_back(event);
        }
    }

    const Event *at(const char *kind, double time) const
    {
        const auto found = events.find(kind);
        if (found == events.end()) {
            return NULL;
        }
        for (const Event &event : found->second) {
            if (time >= event.start && time < event.start + event.length) {
                return &event;
            }
        }
        return NULL;
    }

    double value(const char *kind, double time, double otherwise) const
    {
        const Event *const event = at(kind, time);
        return event != NULL ? event->value : otherwise;
    }

    /* An event that begins now, once. */
    Event *due(const char *kind, double time)
    {
        const auto found = events.find(kind);
        if (found == events.end()) {
            return NULL;
        }
        for (Event &event : found->second) {
            if (!event.done && time >= event.start) {
                event.done = true;
                return &event;
            }
        }
        return NULL;
    }
};

/* A joint by an event's start: the time's microseconds, modulo 7. */
int joint_of(const Event &event)
{
    return static_cast<int>(std::llround(event.start * 1e6) % JOINTS);
}

/* ---- messages ---------------------------------------------------------------------------------------------------- */

typedef std::vector<std::uint8_t> Octets;

void put_varint(Octets *out, std::uint64_t value)
{
    for (; value > 127; value >>= 7) {
        out->push_back(static_cast<std::uint8_t>(value | 128));
    }
    out->push_back(static_cast<std::uint8_t>(value));
}

void put(Octets *out, unsigned number, std::uint64_t value)
{
    put_varint(out, number << 3);
    put_varint(out, value);
}

void put(Octets *out, unsigned number, const Octets &part)
{
    put_varint(out, number << 3 | 2);
    put_varint(out, part.size());
    out->insert(out->end(), part.begin(), part.end());
}

void put_reals(Octets *out, unsigned number, const double *values, int count)
{
    Octets part;
    for (int i = 0; i < count; ++i) {
        part.push_back(0x09);
        std::uint8_t bytes[8];
        std::memcpy(bytes, &values[i], 8); /* little-endian, as the wire is */
        part.insert(part.end(), bytes, bytes + 8);
    }
    put(out, number, part);
}

Octets framed(const Octets &body)
{
    if (FRI_VERSION < 207) {
        return body;
    }
    Octets out;
    const auto word = [&out](std::uint32_t value) {
        for (int i = 0; i < 4; ++i) {
            out.push_back(static_cast<std::uint8_t>(value >> (8 * i)));
        }
    };
    word(static_cast<std::uint32_t>(body.size()));
    out.insert(out.end(), body.begin(), body.end());
    word(checksum(body.data(), body.size()));
    return out;
}

/* A field of this number with length in a message; NULL and 0 if it is not there. */
struct Part {
    const std::uint8_t *bytes;
    std::size_t size;
};

std::uint64_t take_varint(Part *part)
{
    std::uint64_t value = 0;
    for (unsigned shift = 0; part->size > 0; shift += 7) {
        const std::uint8_t byte = *part->bytes++;
        --part->size;
        value |= static_cast<std::uint64_t>(byte & 127) << shift;
        if (byte < 128) {
            break;
        }
    }
    return value;
}

/* What the client sends: fields with a varint, eight bytes, or a length. */
Part field(Part in, unsigned number, std::uint64_t *value = NULL)
{
    while (in.size > 0) {
        const std::uint64_t key = take_varint(&in);
        const unsigned wire = static_cast<unsigned>(key & 7);
        std::uint64_t size = wire == 1 ? 8 : take_varint(&in);
        if (wire == 0) {
            if (key >> 3 == number && value != NULL) {
                *value = size;
            }
            continue;
        }
        if (size > in.size) {
            break;
        }
        if (key >> 3 == number) {
            return Part{in.bytes, static_cast<std::size_t>(size)};
        }
        in.bytes += size;
        in.size -= static_cast<std::size_t>(size);
    }
    return Part{NULL, 0};
}

typedef std::array<double, JOINTS> Vector;

bool take_joints(Part values, Vector *joints)
{
    if (values.size != 9 * JOINTS) {
        return false;
    }
    for (std::size_t i = 0; i < JOINTS; ++i) {
        std::memcpy(&(*joints)[i], values.bytes + 9 * i + 1, 8);
    }
    return true;
}

/* ---- the arm ----------------------------------------------------------------------------------------------------- */

/* Rigid, without gravity and Coriolis forces, that the robot compensates. What blocks a joint is a stiff spring. */
class Arm {
public:
    explicit Arm(const Vector &start) : q(start), anchor_(start) { dq.fill(0.0), external.fill(0.0), blocked_.fill(false); }

    /* Held by the robot's brakes or its position control. */
    void hold()
    {
        dq.fill(0.0);
        external.fill(0.0);
    }

    void step(const Vector &torque, const Vector &push, const std::array<bool, JOINTS> &blocked, double time)
    {
        double M[JOINTS * JOINTS];
        ROBOT_MASS_MATRIX(q.data(), M);
        Vector force;
        for (std::size_t i = 0; i < JOINTS; ++i) {
            anchor_[i] = blocked[i] && !blocked_[i] ? q[i] : anchor_[i];
            external[i] = push[i] + (blocked[i] ? BLOCK * (anchor_[i] - q[i]) - DAMPING * dq[i] : 0.0);
            const int joint = static_cast<int>(i);
            const double beyond = q[i] - std::min(std::max(q[i], robot::lower(joint)), robot::upper(joint));
            external[i] -= beyond != 0.0 ? BLOCK * beyond + DAMPING * dq[i] : 0.0;
            force[i] = torque[i] + external[i] - FRICTION * dq[i];
            M[i * JOINTS + i] += MOTOR;
        }
        blocked_ = blocked;
        const Vector rate = solve(M, force);
        kinetic = 0.0;
        for (std::size_t i = 0; i < JOINTS; ++i) {
            dq[i] += time * rate[i];
            work += time * torque[i] * dq[i];
            q[i] += time * dq[i];
        }
        for (std::size_t i = 0; i < JOINTS; ++i) {
            for (std::size_t j = 0; j < JOINTS; ++j) {
                kinetic += 0.5 * dq[i] * M[i * JOINTS + j] * dq[j];
            }
        }
    }

    Vector q, dq, external; /* [rad], [rad/s], [N m] of the environment */
    double kinetic = 0.0, work = 0.0; /* [J]; done by the torques given */

private:
    static constexpr double BLOCK = 2e4, DAMPING = 60.0, FRICTION = 0.5, MOTOR = 0.2;

    static Vector solve(const double *M, const Vector &right)
    {
        double L[JOINTS][JOINTS];
        Vector x = right;
        for (int i = 0; i < JOINTS; ++i) {
            for (int j = 0; j <= i; ++j) {
                double sum = M[i * JOINTS + j];
                for (int k = 0; k < j; ++k) {
                    sum -= L[i][k] * L[j][k];
                }
                L[i][j] = i == j ? std::sqrt(sum) : sum / L[j][j];
            }
        }
        for (int i = 0; i < JOINTS; ++i) {
            for (int k = 0; k < i; ++k) {
                x[static_cast<std::size_t>(i)] -= L[i][k] * x[static_cast<std::size_t>(k)];
            }
            x[static_cast<std::size_t>(i)] /= L[i][i];
        }
        for (int i = JOINTS - 1; i >= 0; --i) {
            for (int k = i + 1; k < JOINTS; ++k) {
                x[static_cast<std::size_t>(i)] -= L[k][i] * x[static_cast<std::size_t>(k)];
            }
            x[static_cast<std::size_t>(i)] /= L[i][i];
        }
        return x;
    }

    Vector anchor_;
    std::array<bool, JOINTS> blocked_;
};

constexpr double Arm::BLOCK, Arm::DAMPING, Arm::FRICTION, Arm::MOTOR;

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

const double END = 4.0;      /* [s] after which the robot has ended the session, and is silent */
const double LONGEST = 30.0; /* [s] after which a client that has not left never will */

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
        if (seconds() > LONGEST) {
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
            const double elapsed = std::min(1e-9 * static_cast<double>(now_ns - last_cycle_), 0.1);
            const int count = std::max(1, static_cast<int>(std::lround(elapsed / 0.00025)));
            for (int k = 0; k < count; ++k) {
                arm.step(torque_, push, blocked, elapsed / count);
                kinetic = std::max(kinetic, arm.kinetic);
                for (int i = 0; i < JOINTS; ++i) {
                    fast = std::max(fast, std::fabs(arm.dq[static_cast<std::size_t>(i)]) / robot::velocity(i));
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
        Vector q = arm.q, external;
        const Event *const off = schedule.at("offset", time), *const broken = schedule.at("nan", time);
        const double noise = schedule.value("noise", time, 0.0), gain = schedule.value("gain", time, 1.0);
        for (std::size_t i = 0; i < JOINTS; ++i) {
            q[i] += noise * (2.0 * uniform_(random_) - 1.0);
            external[i] = gain * arm.external[i];
        }
        if (off != NULL) {
            q[static_cast<std::size_t>(joint_of(*off))] += off->value;
        }
        if (broken != NULL) {
            q[static_cast<std::size_t>(static_cast<int>(broken->value) % JOINTS)] = std::nan("");
        }
        if ((without & 1) == 0) {
            put_reals(&measured, 1, q.data(), JOINTS);
        }
        put_reals(&measured, 2, torque_.data(), JOINTS);
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
    Vector torque_, commanded_, anchor_; /* in force; received, in force from the next cycle on; interpolator's */
};

/* ---- a session --------------------------------------------------------------------------------------------------- */

/* What only the client's records show. */
struct Seen {
    double elastic = 0.0, lead = 0.0, reference = 0.0, error = 0.0;
    bool let_go = false;
    double let_go_time = -1.0, zero_time = -1.0;
};

struct Place {
    double time;
    Vector q0;
};

const char *boolean(bool value)
{
    return value ? "true" : "false";
}

void session(const Schedule &schedule, const std::string &file, int period)
{
    now_ns = 0;
    interrupts = 0;
    Options options;
    options.timeout = 1000;
    options.wait = 3.0;
    options.settings.approach_time = 0.3;
    options.settings.pace.patience = 1.0;
    options.settings.may_ask = schedule.events.count("answer") > 0;
    const Trajectory trajectory(file, options.trajectory_period);
    Vector start, rate;
    trajectory.at(0.0, start.data(), rate.data());
    start[0] += 0.02;
    World world(schedule, start, period);
    std::unique_ptr<Records> records(new Records);
    Question question;
    std::unique_ptr<Connection> connection(new Connection(world, 1e-3 * options.timeout));
    std::unique_ptr<WipingClient> client(
        new WipingClient(options.settings, trajectory, NULL, *connection, *records, question));
    KUKA::FRI::ClientApplication application(*connection, *client);
    for (int i = 0; i < JOINTS; ++i) {
        world.effort[i] = client->config().effort_limit[i];
        world.torque_rate[i] = client->config().torque_rate_limit[i];
    }
    Seen seen;
    std::deque<Place> places; /* of the reference, in one motion */
    double slack = 1e300;     /* least of progress minus time so far */
    const double energy_limit = client->config().energy_limit;
    world.watch = [&] {
        world.sample_time = client->sample_time();
        const Event *const answer = world.schedule.due("answer", seconds());
        if (answer != NULL && question.state() == Question::ASKED) {
            question.answer(answer->value >= 0.5);
        }
        const double ahead = client->progress() - seconds();
        slack = std::min(slack, ahead);
        seen.lead = std::max(seen.lead, (ahead - slack) / client->sample_time() / 8.0);
        Record record;
        while (records->pop(&record)) {
            if ((record.events & EVENT_LET_GO) != 0 && !seen.let_go) {
                seen.let_go = true;
                seen.let_go_time = seconds();
            }
            if (record.kind == Record::STATE || record.start || record.reset) {
                places.clear();
            }
            if (record.kind != Record::STEP || !record.sample_valid) {
                continue;
            }
            seen.elastic = std::max(seen.elastic, record.elastic_energy / energy_limit);
            double wanted[16], there[16], square = 0.0;
            robot::pose(record.q0, wanted);
            robot::pose(world.arm.q.data(), there);
            for (int i = 0; i < 3; ++i) {
                square += (wanted[4 * i + 3] - there[4 * i + 3]) * (wanted[4 * i + 3] - there[4 * i + 3]);
            }
            seen.error = std::max(seen.error, std::sqrt(square));
            Place place = {seconds(), Vector()};
            std::copy(record.q0, record.q0 + JOINTS, place.q0.begin());
            for (const Place &old : places) {
                for (int i = 0; i < JOINTS; ++i) {
                    const std::size_t k = static_cast<std::size_t>(i);
                    const double allowed = place.time - old.time + 8.0 * client->sample_time();
                    seen.reference = std::max(seen.reference, std::fabs(place.q0[k] - old.q0[k]) /
                                                                  (robot::velocity(i) * allowed));
                }
            }
            places.push_back(place);
            if (places.size() > 40) {
                places.pop_front();
            }
        }
        if (seen.let_go && seen.zero_time < 0.0 && world.last_torque == 0.0) {
            seen.zero_time = seconds();
        }
    };
    application.connect(30200);
    Ending ending = {FAULT, "the client does not end"};
    try {
        ending = run_session(options, *client, *connection, application, interrupts);
    } catch (const std::runtime_error &error) {
        ending.sentence = error.what();
    }
    Record record;
    while (records->pop(&record)) {
        seen.let_go = seen.let_go || (record.events & EVENT_LET_GO) != 0;
    }
    seen.let_go = seen.let_go || client->gone() != LET_GO_NONE;
    const double last = seconds();
    const long recent = std::count_if(world.deliveries.begin(), world.deliveries.end(),
                                      [last](double time) { return time > last - 0.5; });
    std::printf("{\"code\": %d, \"sentence\": \"%s\", \"over_limit\": %.17g, \"step\": %.17g, \"rate\": %.17g, "
                "\"lead\": %.17g, \"reference\": %.17g, \"elastic\": %.17g, \"error\": %.17g, \"kinetic\": %.17g, "
                "\"fast\": %.17g, \"work\": %.17g, \"axis_delta\": %.17g, \"unanswered\": %u, \"not_finite\": %u, "
                "\"sent\": %u, \"last_torque\": %.17g, \"recent\": %ld, \"time\": %.17g, ",
                static_cast<int>(ending.code), ending.sentence.c_str(), world.over_limit, world.step, world.rate,
                seen.lead, seen.reference, seen.elastic, seen.error, world.kinetic, world.fast, world.arm.work,
                world.axis_delta, world.unanswered, world.not_finite, world.sent, world.last_torque, recent, last);
    std::printf("\"release\": %.17g, \"let_go\": %s, \"done\": %s, \"idle\": %s, \"interrupted\": %s, \"interrupts\": %d, "
                "\"declined\": %s, \"moved\": %s, \"refused\": %s, \"state\": %d, \"progress\": %.17g}\n",
                seen.zero_time >= 0.0 ? seen.zero_time - seen.let_go_time : -1.0, boolean(seen.let_go),
                boolean(client->trajectory_done()), boolean(world.idle_seen), boolean(world.interrupted),
                static_cast<int>(interrupts), boolean(client->question().state() == Question::NO), boolean(world.moved),
                boolean(client->refusal() != REFUSAL_NONE), world.last_state, client->progress());
    std::fflush(stdout);
}

} // namespace

int main(int argc, char **argv)
{
    if (argc != 3) {
        std::fprintf(stderr, "attack TRAJECTORY PERIOD_MS\n");
        return 2;
    }
    for (std::string line; std::getline(std::cin, line);) {
        session(Schedule(line), argv[1], std::atoi(argv[2]));
    }
    return 0;
}
