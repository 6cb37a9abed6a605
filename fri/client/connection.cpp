// SPDX-License-Identifier: MIT
#include "connection.h"

#include <algorithm>

namespace {

/* A counter at most this far behind the last one belongs to an old message. */
const std::uint32_t REORDER_WINDOW = 100;

/* A counter further ahead than this, or behind, is no gap of lost messages. */
const std::uint32_t LARGEST_GAP = 1u << 20;

/* Consecutive messages in order, with counters far from the session's, after which the counter has restarted. */
const int ANEW = 10;

/* Most datagrams checked for one answer: a flood must not keep the robot waiting. */
const int MOST_WAITING = 1024;

const double NEVER = 1e300;

/* Return the periods of several messages: 0 from the message on at which the counter began anew. */
std::uint32_t add_periods(std::uint32_t sum, std::uint32_t periods, bool *anew)
{
    *anew = *anew || periods == 0;
    return *anew ? 0 : sum + periods;
}

} // namespace

/* Return how many datagrams were refused, for whatever fault. */
unsigned long long Traffic::refused() const
{
    unsigned long long sum = 0;
    for (const unsigned long long count : faults) {
        sum += count;
    }
    return sum;
}

/* Wait at most `patience` [s] for a message. */
Connection::Connection(Datagrams &datagrams, double patience)
    : datagrams_(datagrams), patience_(patience), deadline_(NEVER), handed_on_(false), handing_time_(0.0), sequence_(0),
      sequence_known_(false), elsewhere_(0), in_a_row_(0), last_answer_(0), reflected_(0),
      answered_(false), reflection_known_(false)
{
    std::memset(&arrival_, 0, sizeof arrival_);
    std::memset(&traffic_, 0, sizeof traffic_);
}

/* Note a counter far from the session's. Return whether several in a row have told that the robot counts anew. */
bool Connection::counts_anew(std::uint32_t counter)
{
    const std::uint32_t since = counter - elsewhere_;
    const bool goes_on = in_a_row_ > 0 && since > 0 && since <= REORDER_WINDOW;
    in_a_row_ = goes_on ? in_a_row_ + 1 : 1;
    elsewhere_ = counter;
    return in_a_row_ >= ANEW;
}

/*
 * Check that the message follows the last one, and go on from it. advance: its counter's periods since the last one, 0
 * if that is not known. Counters and their differences wrap round at 2^32: one behind is far ahead.
 */
Fault Connection::follow_counter(const Message &message, std::uint32_t *advance)
{
    const std::uint32_t ahead = message.sequence - sequence_, behind = sequence_ - message.sequence;
    *advance = 0;
    if (sequence_known_ && ahead == 0) {
        return FAULT_DUPLICATE;
    }
    if (sequence_known_ && ahead > LARGEST_GAP) {
        const bool is_anew = counts_anew(message.sequence);
        if (behind <= REORDER_WINDOW || !is_anew) { /* overtaken by the last one, or not sure yet */
            return FAULT_OUT_OF_ORDER;
        }
    } else if (sequence_known_) {
        *advance = ahead;
        traffic_.lost_messages += ahead - 1;
    }
    in_a_row_ = 0;
    sequence_ = message.sequence;
    sequence_known_ = message.state != 0; /* an idle robot may count anew */
    return FAULT_NONE;
}

/* Count the answers that the robot has not seen: a message reflects the counter of the last one that it has. */
void Connection::count_answers(const Message &message)
{
    if (!answered_ || last_answer_ - message.reflected > LARGEST_GAP) {
        return;
    }
    const std::uint32_t advance = reflection_known_ ? message.reflected - reflected_ : message.reflected + 1;
    if (advance > 0 && advance <= LARGEST_GAP) {
        traffic_.lost_answers += advance - 1;
        reflected_ = message.reflected;
        reflection_known_ = true;
    }
    traffic_.unseen_answers += message.reflected != last_answer_ ? 1 : 0;
}

/* Return whether a datagram is a message to be handed on. */
bool Connection::take(const std::uint8_t *bytes, int size, Message *message, std::uint32_t *advance)
{
    const std::size_t count = static_cast<std::size_t>(size);
    ++traffic_.received;
    Fault fault = check_datagram(bytes, count, message);
    if (fault == FAULT_NONE && sequence_known_ && !datagrams_.from_peer()) {
        fault = FAULT_SENDER;
    } else if (fault == FAULT_NONE) {
        fault = follow_counter(*message, advance);
    } else if (other_framing(bytes, count)) { /* a robot of another FRI version */
        ++traffic_.other_framing;
    }
    if (fault != FAULT_NONE) {
        ++traffic_.faults[fault];
        arrival_.refused = true;
        return false;
    }
    datagrams_.adopt_peer();
    count_answers(*message);
    return true;
}

/* Read the next datagram into scratch_, waiting for so long [s]. Return its size, or a negative number. */
int Connection::next(double wait, double *age)
{
    const int size = datagrams_.receive(scratch_, sizeof scratch_, wait, age);
    signalled_ = size == Datagrams::SIGNALLED;
    return size;
}

/*
 * Take datagrams until one is a message and none is waiting, or until `give_up` [s]. Return the size of the newest
 * message, which is in the buffer, or -1; advance: periods since the last one, 0 if the counter began anew.
 */
int Connection::collect(Buffer buffer, std::size_t capacity, double give_up, std::uint32_t *advance)
{
    int taken = -1; /* size of the newest message */
    bool anew = false;
    for (int looked_at = 0; taken < 0 || looked_at < MOST_WAITING; ++looked_at) {
        const bool has_message = taken >= 0;
        const double left = std::max(give_up - monotonic_time(), 0.0); /* [s] */
        if (!has_message && left <= 0.0 && looked_at > 0) {
            break; /* refused datagrams alone, without a pause */
        }
        double age = 0.0;
        const int size = next(has_message ? 0.0 : left, &age); /* with a message, what waits alone */
        if (size < 0) {
            break;
        }
        Message message;
        std::uint32_t periods = 0;
        if (!take(scratch_, size, &message, &periods)) {
            continue;
        }
        traffic_.overtaken += has_message ? 1 : 0;
        *advance = add_periods(*advance, periods, &anew);
        taken = size;
        arrival_.message = message;
        arrival_.age = age;
        std::memcpy(buffer, scratch_, std::min(static_cast<std::size_t>(size), capacity));
        if (message.multiplier > 1) {
            break; /* the library counts the messages per answer */
        }
    }
    return taken;
}

/* Count a silence: after it the next message may have any counter. */
void Connection::note_silence()
{
    traffic_.timeouts += traffic_.messages > 0 ? 1 : 0;
    sequence_known_ = false;
}

/* Return the size of the newest message, in the buffer, or -1 after a silence, a signal or the deadline. */
int Connection::receive(Buffer buffer, Size capacity)
{
    const double give_up = std::min(monotonic_time() + patience_, deadline_);
    std::uint32_t advance = 0;
    arrival_.refused = signalled_ = false;
    const int taken = collect(buffer, static_cast<std::size_t>(capacity), give_up, &advance);
    handed_on_ = taken >= 0;
    if (!handed_on_) {
        if (!signalled_) {
            note_silence();
        }
        return -1;
    }
    const Message &message = arrival_.message;
    const bool sends_commanded_position = FRI_VERSION < 200; /* 1.x alone does */
    arrival_.other_version = message.has_measurement && message.has_commanded_position != sends_commanded_position;
    traffic_.other_version += arrival_.other_version ? 1 : 0;
    arrival_.advance = advance;
    ++traffic_.messages;
    handing_time_ = monotonic_time();
    return taken;
}

/* Send an answer, and note how long it took from the message's arrival and which counter it has. */
bool Connection::send(SendBytes bytes, Size size)
{
    const std::uint8_t *const data = reinterpret_cast<const std::uint8_t *>(bytes);
    const bool sent = datagrams_.send(data, static_cast<std::size_t>(size));
    answers_.add(arrival_.age + monotonic_time() - handing_time_);
    answered_ = answer_counter(data, static_cast<std::size_t>(size), &last_answer_) || answered_;
    traffic_.send_failures += sent ? 0 : 1;
    return sent;
}
