// SPDX-License-Identifier: MIT
/* Datagrams, looked through before the FRI library's decoder sees them. */
#include "frame.h"

#include "checksum.h"

#include <cstring>

const char *const BUTTON = "MediaFlange.UserButton";

namespace {

const std::uint32_t MONITORING_IDENTIFIER = 0x245142;
const std::size_t JOINT_COUNT = 7;

/* ---- the fields ------------------------------------------------------------------------------------------------- */

enum Kind { COUNT32, CHOICE, NUMBER, COUNT64, REAL, TEXT, PART };

enum Type {
    MONITORING,
    HEADER,
    ROBOT,
    MEASUREMENT,
    CONNECTION,
    INTERPOLATOR,
    JOINT_VALUES,
    VECTOR,
    TIME,
    TRANSFORMATION,
    IO,
    REDUNDANCY,
    TYPE_COUNT
};

/* A field of a message: its kind; for CHOICE the largest value, for TEXT the longest, for PART the message in it; how
 * often it must and may be there. Fields that are not in the table are skipped, as in every decoder of the format. */
struct Field {
    Type of;
    std::uint32_t number;
    Kind kind;
    std::uint32_t more;
    std::size_t least, most;
};

const std::size_t ANY = DATAGRAM_SIZE;

const Field FIELDS[] = {
    {MONITORING, 1, PART, HEADER, 1, 1},
    {MONITORING, 2, PART, ROBOT, 0, 1},
    {MONITORING, 3, PART, MEASUREMENT, 0, 1},
    {MONITORING, 4, PART, CONNECTION, 0, 1},
    {MONITORING, 5, PART, INTERPOLATOR, 0, 1},
    {MONITORING, 6, PART, TRANSFORMATION, 0, 5},
    {HEADER, 1, COUNT32, 0, 1, 1},
    {HEADER, 2, COUNT32, 0, 1, 1},
    {HEADER, 3, COUNT32, 0, 1, 1},
    {ROBOT, 1, NUMBER, 0, 0, 1},
    {ROBOT, 2, CHOICE, 3, 0, 1},
    {ROBOT, 5, CHOICE, 2, 0, ANY},
    {ROBOT, 6, CHOICE, 2, 0, 1},
    {ROBOT, 7, CHOICE, 3, 0, 1},
    {MEASUREMENT, 1, PART, JOINT_VALUES, 0, 1},
    {MEASUREMENT, 2, PART, JOINT_VALUES, 0, 1},
    {MEASUREMENT, 3, PART, JOINT_VALUES, 0, 1},
    {MEASUREMENT, 4, PART, JOINT_VALUES, 0, 1},
    {MEASUREMENT, 5, PART, JOINT_VALUES, 0, 1},
    {MEASUREMENT, 6, PART, VECTOR, 0, 1},
    {MEASUREMENT, 8, PART, IO, 0, 10},
    {MEASUREMENT, 9, PART, TRANSFORMATION, 0, 1},
    {MEASUREMENT, 10, PART, REDUNDANCY, 0, 1},
    {MEASUREMENT, 15, PART, TIME, 0, 1},
    {CONNECTION, 1, CHOICE, 4, 1, 1},
    {CONNECTION, 2, CHOICE, 3, 1, 1},
    {CONNECTION, 3, COUNT32, 0, 0, 1},
    {CONNECTION, 4, COUNT32, 0, 0, 1},
    {INTERPOLATOR, 1, PART, JOINT_VALUES, 0, 1},
    {INTERPOLATOR, 2, PART, TRANSFORMATION, 0, 1},
    {INTERPOLATOR, 3, PART, REDUNDANCY, 0, 1},
    {INTERPOLATOR, 10, CHOICE, 4, 0, 1},
    {INTERPOLATOR, 11, CHOICE, 2, 0, 1},
    {INTERPOLATOR, 12, REAL, 0, 0, 1},
    {JOINT_VALUES, 1, REAL, 0, 0, ANY},
    {VECTOR, 1, REAL, 0, 0, 6},
    {TIME, 1, COUNT32, 0, 1, 1},
    {TIME, 2, COUNT32, 0, 1, 1},
    {TRANSFORMATION, 1, TEXT, 63, 1, 1},
    {TRANSFORMATION, 2, REAL, 0, 0, FRI_VERSION < 200 ? 12 : 7},
    {TRANSFORMATION, 3, PART, TIME, 0, 1},
    {IO, 1, TEXT, 63, 1, 1},
    {IO, 2, CHOICE, 2, 1, 1},
    {IO, 3, CHOICE, 1, 1, 1},
    {IO, 4, COUNT64, 0, 0, 1},
    {IO, 5, REAL, 0, 0, 1},
    {REDUNDANCY, 1, CHOICE, 4, 1, 1},
    {REDUNDANCY, 2, REAL, 0, 1, 1},
};

enum { FIELD_COUNT = sizeof FIELDS / sizeof *FIELDS, MOST_FIELDS = 16 };

/* ---- the wire format -------------------------------------------------------------------------------------------- */

enum Wire { VARINT = 0, EIGHT = 1, BLOCK = 2, FOUR = 5 };

/* Bytes that are read from the front. Every read says whether there was enough. */
class Bytes {
public:
    Bytes(const std::uint8_t *begin, std::size_t size) : at_(begin), left_(size) {}

    bool empty() const { return left_ == 0; }
    const std::uint8_t *at() const { return at_; }
    std::size_t left() const { return left_; }

    bool skip(std::size_t count)
    {
        if (count > left_) {
            return false;
        }
        at_ += count;
        left_ -= count;
        return true;
    }

    bool varint(std::uint64_t *value)
    {
        *value = 0;
        for (unsigned shift = 0; shift < 64; shift += 7) {
            if (left_ == 0) {
                return false;
            }
            const std::uint8_t byte = *at_;
            skip(1);
            *value |= static_cast<std::uint64_t>(byte & 127) << shift;
            if (byte < 128) {
                return true;
            }
        }
        return false;
    }

    bool key(std::uint32_t *number, std::uint32_t *wire)
    {
        std::uint64_t value = 0;
        if (!varint(&value) || value > 0xffffffffu || (value >> 3) == 0) {
            return false;
        }
        *number = static_cast<std::uint32_t>(value >> 3);
        *wire = static_cast<std::uint32_t>(value & 7);
        return true;
    }

    /* The part of `size` bytes at the front. */
    bool block(Bytes *part)
    {
        std::uint64_t size = 0;
        if (!varint(&size) || size > left_) {
            return false;
        }
        *part = Bytes(at_, static_cast<std::size_t>(size));
        return skip(static_cast<std::size_t>(size));
    }

    bool skip_field(std::uint32_t wire)
    {
        std::uint64_t value = 0;
        Bytes part(NULL, 0);
        switch (wire) {
        case VARINT: return varint(&value);
        case EIGHT: return skip(8);
        case BLOCK: return block(&part);
        case FOUR: return skip(4);
        default: return false;
        }
    }

private:
    const std::uint8_t *at_;
    std::size_t left_;
};

/* ---- a message -------------------------------------------------------------------------------------------------- */

/* The whole message, as if it were a field. */
const Field WHOLE = {TYPE_COUNT, 0, PART, MONITORING, 1, 1};

/* One walk through a message. */
class Walk {
public:
    explicit Walk(Message *message)
        : message_(message), identifier_(0), seconds_(0), nanoseconds_(0), button_(false), boolean_(false)
    {
    }

    /* The message in a field. */
    Fault part(const Field &around, Bytes bytes);

    std::uint32_t identifier() const { return identifier_; }
    std::int64_t stamp() const { return static_cast<std::int64_t>(seconds_) * 1000000000 + nanoseconds_; }

private:
    Fault field(const Field &around, const Field &field, std::uint32_t wire, Bytes *bytes, std::size_t *count);
    Fault text(const Field &field, Bytes text);
    Fault number(const Field &around, const Field &field, std::uint64_t value);
    void see_number(const Field &around, const Field &field, std::uint32_t value);
    void see_part(const Field &field);
    Fault complete(std::size_t first, const std::size_t *counts);

    Message *message_;
    std::uint32_t identifier_, seconds_, nanoseconds_;
    bool button_, boolean_; /* of the IO that is read: it has the button's name; its type */
};

Fault Walk::part(const Field &around, Bytes bytes)
{
    std::size_t first = 0, counts[MOST_FIELDS] = {0};
    while (FIELDS[first].of != static_cast<Type>(around.more)) {
        ++first;
    }
    while (!bytes.empty()) {
        std::uint32_t number = 0, wire = 0;
        if (!bytes.key(&number, &wire)) {
            return FAULT_DECODE;
        }
        std::size_t i = first;
        while (i < FIELD_COUNT && FIELDS[i].of == FIELDS[first].of && FIELDS[i].number != number) {
            ++i;
        }
        Fault fault = FAULT_NONE;
        if (i == FIELD_COUNT || FIELDS[i].of != FIELDS[first].of) {
            fault = bytes.skip_field(wire) ? FAULT_NONE : FAULT_DECODE;
        } else {
            std::size_t *const count = &counts[i - first];
            fault = field(around, FIELDS[i], wire, &bytes, count);
            fault = fault == FAULT_NONE && *count > FIELDS[i].most ? FAULT_DECODE : fault;
        }
        if (fault != FAULT_NONE) {
            return fault;
        }
    }
    return complete(first, counts);
}

/* Check that every field is there as often as it must be. */
Fault Walk::complete(std::size_t first, const std::size_t *counts)
{
    const Type type = FIELDS[first].of;
    std::size_t robot_states = 0;
    for (std::size_t i = first; i < FIELD_COUNT && FIELDS[i].of == type; ++i) {
        const std::size_t count = counts[i - first];
        if (count < FIELDS[i].least) {
            return FAULT_DECODE;
        }
        const bool drives = type == ROBOT && FIELDS[i].number == 5 && count != 0;
        if ((type == JOINT_VALUES || drives) && count != JOINT_COUNT) {
            return FAULT_JOINT_COUNT;
        }
        const bool state = FIELDS[i].number == 2 || FIELDS[i].number == 5 || FIELDS[i].number == 6;
        robot_states += type == ROBOT && state && count > 0 ? 1 : 0;
    }
    message_->has_robot = message_->has_robot || robot_states == 3;
    return FAULT_NONE;
}

Fault Walk::field(const Field &around, const Field &field, std::uint32_t wire, Bytes *bytes, std::size_t *count)
{
    /* Arrays of numbers come one key a value, or packed into a block. */
    const bool array = field.most > 1 && (field.kind == REAL || field.kind == CHOICE);
    const bool block = field.kind == PART || field.kind == TEXT || (array && wire == BLOCK);
    const Wire plain = field.kind == REAL ? EIGHT : VARINT;
    Bytes inside(NULL, 0);
    std::uint64_t value = 0;
    if (wire != static_cast<std::uint32_t>(block ? BLOCK : plain) || (block && !bytes->block(&inside))) {
        return FAULT_DECODE;
    }
    *count += 1;
    if (field.kind == PART) {
        see_part(field);
        return part(field, inside);
    }
    if (field.kind == TEXT) {
        return text(field, inside);
    }
    if (field.kind == REAL) {
        *count += block ? inside.left() / 8 - 1 : 0;
        return (block ? inside.left() % 8 == 0 : bytes->skip(8)) ? FAULT_NONE : FAULT_DECODE;
    }
    if (!block) {
        return bytes->varint(&value) ? number(around, field, value) : FAULT_DECODE;
    }
    Fault fault = FAULT_NONE;
    for (*count -= 1; fault == FAULT_NONE && !inside.empty(); ++*count) {
        fault = inside.varint(&value) ? number(around, field, value) : FAULT_DECODE;
    }
    return fault;
}

Fault Walk::text(const Field &field, Bytes text)
{
    if (text.left() > field.more) {
        return FAULT_DECODE;
    }
    if (field.of == IO) {
        button_ = text.left() == std::strlen(BUTTON) && std::memcmp(text.at(), BUTTON, text.left()) == 0;
        message_->has_button = message_->has_button || (button_ && boolean_);
    }
    return FAULT_NONE;
}

Fault Walk::number(const Field &around, const Field &field, std::uint64_t value)
{
    if (field.kind == COUNT32 && value > 0xffffffffu) {
        return FAULT_DECODE;
    }
    const bool strategy = field.of == REDUNDANCY && value != 0 && value != 4;
    const bool second = field.of == TIME && field.number == 2 && value >= 1000000000u;
    if ((field.kind == CHOICE && value > field.more) || strategy || second) {
        return FAULT_RANGE;
    }
    if (field.of == ROBOT && field.number == 1 && value != JOINT_COUNT) {
        return FAULT_JOINT_COUNT;
    }
    see_number(around, field, static_cast<std::uint32_t>(value));
    return FAULT_NONE;
}

void Walk::see_number(const Field &around, const Field &field, std::uint32_t value)
{
    if (field.of == HEADER) {
        (field.number == 1 ? identifier_ : field.number == 2 ? message_->sequence : message_->reflected) = value;
    } else if (field.of == CONNECTION && field.number == 1) {
        message_->state = value;
    } else if (field.of == CONNECTION && field.number == 4) {
        message_->multiplier = value;
    } else if (field.of == TIME && around.of == MEASUREMENT) {
        (field.number == 1 ? seconds_ : nanoseconds_) = value;
    } else if (field.of == IO && field.number == 2) {
        boolean_ = value == 0;
        message_->has_button = message_->has_button || (button_ && boolean_);
    }
}

void Walk::see_part(const Field &field)
{
    if (field.of == MONITORING) {
        message_->has_measurement = message_->has_measurement || field.more == MEASUREMENT;
        message_->has_connection = message_->has_connection || field.more == CONNECTION;
        message_->has_interpolator = message_->has_interpolator || field.more == INTERPOLATOR;
    } else if (field.of == MEASUREMENT) {
        message_->has_position = message_->has_position || field.number == 1;
        message_->has_commanded_position = message_->has_commanded_position || field.number == 3;
        message_->has_external_torque = message_->has_external_torque || field.number == 5;
        button_ = boolean_ = false;
    } else if (field.of == INTERPOLATOR) {
        message_->has_ipo = message_->has_ipo || field.number == 1;
    }
}

/* ---- the frame -------------------------------------------------------------------------------------------------- */

const std::size_t FRONT = 4, BACK = 4; /* length and checksum around a message of 2.7 */

/* The message in a frame of 2.7. */
Fault unframe(const std::uint8_t *datagram, std::size_t size, Bytes *body)
{
    if (size < FRONT + BACK || read_little_endian(datagram) != size - FRONT - BACK) {
        return FAULT_FRAME;
    }
    *body = Bytes(datagram + FRONT, size - FRONT - BACK);
    const bool sound = read_little_endian(datagram + size - BACK) == checksum(body->at(), body->left());
    return sound ? FAULT_NONE : FAULT_CHECKSUM;
}

Fault check_body(Bytes body, Message *message)
{
    std::memset(message, 0, sizeof *message);
    Walk walk(message);
    const Fault fault = walk.part(WHOLE, body);
    if (fault != FAULT_NONE) {
        return fault;
    }
    message->stamp = walk.stamp();
    if (walk.identifier() != MONITORING_IDENTIFIER) {
        return FAULT_IDENTIFIER;
    }
    const bool idle = message->state == 0, commanding = message->state >= 3;
    const bool complete = message->has_connection && (idle || message->has_measurement) &&
                          (!commanding || message->has_interpolator);
    return complete ? FAULT_NONE : FAULT_INCOMPLETE;
}

} // namespace

const char *fault_name(int fault)
{
    static const char *const names[FAULT_COUNT] = {"none",   "empty",      "too_long",    "frame",
                                                   "checksum", "decode",   "identifier",  "joint_count",
                                                   "range",  "incomplete", "duplicate",   "out_of_order",
                                                   "sender"};
    return fault >= 0 && fault < FAULT_COUNT ? names[fault] : "unknown";
}

Fault check_datagram(const std::uint8_t *datagram, std::size_t size, Message *message)
{
    if (size == 0 || size > DATAGRAM_SIZE) {
        return size == 0 ? FAULT_EMPTY : FAULT_TOO_LONG;
    }
    Bytes body(datagram, size);
    const Fault fault = FRI_VERSION >= 207 ? unframe(datagram, size, &body) : FAULT_NONE;
    return fault == FAULT_NONE ? check_body(body, message) : fault;
}

bool other_framing(const std::uint8_t *datagram, std::size_t size)
{
    Message message;
    Bytes body(datagram, size);
    const bool framed = FRI_VERSION < 207 && unframe(datagram, size, &body) == FAULT_NONE;
    return size <= DATAGRAM_SIZE && (framed || FRI_VERSION >= 207) && check_body(body, &message) == FAULT_NONE;
}

bool answer_counter(const std::uint8_t *datagram, std::size_t size, std::uint32_t *sequence)
{
    const std::size_t front = FRI_VERSION >= 207 ? FRONT : 0;
    if (size < front) {
        return false;
    }
    Bytes body(datagram + front, size - front), header(NULL, 0);
    std::uint32_t number = 0, wire = 0;
    std::uint64_t value = 0;
    if (!body.key(&number, &wire) || number != 1 || wire != BLOCK || !body.block(&header)) {
        return false;
    }
    while (header.key(&number, &wire) && wire == VARINT && header.varint(&value)) {
        if (number == 2) {
            *sequence = static_cast<std::uint32_t>(value);
            return true;
        }
    }
    return false;
}
