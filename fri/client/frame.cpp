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

/* A field of a message of type `of`. Fields that are not in the table are skipped, as in every decoder of the format. A
 * row of the table: type, number, kind, more, least, most. */
struct Field {
    Type of;
    std::uint32_t number;
    Kind kind;
    std::uint32_t more;      /* CHOICE: largest value; TEXT: longest; PART: type of the message in it; else 0 */
    std::size_t least, most; /* how often it must and may be there */
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
    Fault reals(Bytes *bytes, bool block, std::size_t *count);
    Fault numbers(const Field &around, const Field &field, Bytes *bytes, bool block, std::size_t *count);
    Fault text(const Field &field, Bytes text);
    Fault number(const Field &around, const Field &field, std::uint64_t value);
    std::uint32_t *place(const Field &around, const Field &field);
    void see_number(const Field &around, const Field &field, std::uint32_t value);
    void see_part(const Field &field);
    Fault complete(std::size_t first, const std::size_t *counts);

    Message *message_;
    std::uint32_t identifier_, seconds_, nanoseconds_;
    bool button_, boolean_; /* of the IO that is read: it has the button's name; its type */
};

/* Return the first field of a type in the table. */
std::size_t first_field(Type type)
{
    std::size_t first = 0;
    while (FIELDS[first].of != type) {
        ++first;
    }
    return first;
}

/* Return the field with this number, of the same type as `first`; FIELD_COUNT if the table has none. */
std::size_t find_field(std::size_t first, std::uint32_t number)
{
    for (std::size_t i = first; i < FIELD_COUNT && FIELDS[i].of == FIELDS[first].of; ++i) {
        if (FIELDS[i].number == number) {
            return i;
        }
    }
    return FIELD_COUNT;
}

/* Read the fields of one part of the message, whose type is around.more, and check their numbers. */
Fault Walk::part(const Field &around, Bytes bytes)
{
    const std::size_t first = first_field(static_cast<Type>(around.more));
    std::size_t counts[MOST_FIELDS] = {0};
    while (!bytes.empty()) {
        std::uint32_t number = 0, wire = 0;
        if (!bytes.key(&number, &wire)) {
            return FAULT_DECODE;
        }
        const std::size_t i = find_field(first, number);
        Fault fault = FAULT_NONE;
        if (i == FIELD_COUNT) {
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

/* Return whether so many of a field are enough, and seven where there is one for each joint. */
Fault check_count(const Field &field, std::size_t count)
{
    if (count < field.least) {
        return FAULT_DECODE;
    }
    const bool drives = field.of == ROBOT && field.number == 5 && count != 0;
    return (field.of == JOINT_VALUES || drives) && count != JOINT_COUNT ? FAULT_JOINT_COUNT : FAULT_NONE;
}

/* Check that every field is there as often as it must be. */
Fault Walk::complete(std::size_t first, const std::size_t *counts)
{
    const Type type = FIELDS[first].of;
    std::size_t robot_states = 0;
    for (std::size_t i = first; i < FIELD_COUNT && FIELDS[i].of == type; ++i) {
        const std::size_t count = counts[i - first];
        const Fault fault = check_count(FIELDS[i], count);
        if (fault != FAULT_NONE) {
            return fault;
        }
        const bool state = FIELDS[i].number == 2 || FIELDS[i].number == 5 || FIELDS[i].number == 6;
        robot_states += state && count > 0 ? 1 : 0;
    }
    message_->has_robot = message_->has_robot || (type == ROBOT && robot_states == 3);
    return FAULT_NONE;
}

/* Return whether a field comes as a block: a part, a text, or an array of numbers that is packed. */
bool is_block(const Field &field, std::uint32_t wire)
{
    const bool array = field.most > 1 && (field.kind == REAL || field.kind == CHOICE);
    return field.kind == PART || field.kind == TEXT || (array && wire == BLOCK);
}

Fault Walk::field(const Field &around, const Field &field, std::uint32_t wire, Bytes *bytes, std::size_t *count)
{
    const bool block = is_block(field, wire);
    const Wire plain = field.kind == REAL ? EIGHT : VARINT;
    Bytes inside(NULL, 0);
    if (wire != static_cast<std::uint32_t>(block ? BLOCK : plain) || (block && !bytes->block(&inside))) {
        return FAULT_DECODE;
    }
    switch (field.kind) {
    case PART: *count += 1; see_part(field); return part(field, inside);
    case TEXT: *count += 1; return text(field, inside);
    case REAL: return reals(block ? &inside : bytes, block, count);
    default: return numbers(around, field, block ? &inside : bytes, block, count);
    }
}

/* Skip and count the reals of a field: one, or all of a block. */
Fault Walk::reals(Bytes *bytes, bool block, std::size_t *count)
{
    const std::size_t size = block ? bytes->left() : 8;
    *count += size / 8;
    return size % 8 == 0 && bytes->skip(size) ? FAULT_NONE : FAULT_DECODE;
}

/* Read and count the numbers of a field: one, or all of a block. */
Fault Walk::numbers(const Field &around, const Field &field, Bytes *bytes, bool block, std::size_t *count)
{
    Fault fault = FAULT_NONE;
    for (bool more = !block || !bytes->empty(); fault == FAULT_NONE && more; more = block && !bytes->empty()) {
        std::uint64_t value = 0;
        fault = bytes->varint(&value) ? number(around, field, value) : FAULT_DECODE;
        *count += 1;
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

/* Return whether a number is one that its field may have. */
Fault check_number(const Field &field, std::uint64_t value)
{
    if (field.kind == COUNT32 && value > 0xffffffffu) {
        return FAULT_DECODE;
    }
    const bool choice = field.kind == CHOICE && value > field.more;
    const bool strategy = field.of == REDUNDANCY && value != 0 && value != 4;
    const bool second = field.of == TIME && field.number == 2 && value >= 1000000000u;
    return choice || strategy || second ? FAULT_RANGE : FAULT_NONE;
}

Fault Walk::number(const Field &around, const Field &field, std::uint64_t value)
{
    Fault fault = check_number(field, value);
    if (fault == FAULT_NONE && field.of == ROBOT && field.number == 1 && value != JOINT_COUNT) {
        fault = FAULT_JOINT_COUNT;
    }
    if (fault == FAULT_NONE) {
        see_number(around, field, static_cast<std::uint32_t>(value));
    }
    return fault;
}

/* Return where a number of the message is kept, NULL for one that is not. */
std::uint32_t *Walk::place(const Field &around, const Field &field)
{
    std::uint32_t *const header[] = {&identifier_, &message_->sequence, &message_->reflected};
    switch (field.of) {
    case HEADER: return header[field.number - 1];
    case CONNECTION:
        if (field.number == 1) {
            return &message_->state;
        }
        return field.number == 4 ? &message_->multiplier : NULL;
    case TIME:
        if (around.of != MEASUREMENT) {
            return NULL;
        }
        return field.number == 1 ? &seconds_ : &nanoseconds_;
    default: return NULL;
    }
}

void Walk::see_number(const Field &around, const Field &field, std::uint32_t value)
{
    std::uint32_t *const kept = place(around, field);
    if (kept != NULL) {
        *kept = value;
    }
    if (field.of == IO && field.number == 2) {
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

/* Read a message without its frame; a robot that commands must also send measurement and interpolator. */
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
        if (number == 2) { /* header.sequenceCounter */
            *sequence = static_cast<std::uint32_t>(value);
            return true;
        }
    }
    return false;
}
