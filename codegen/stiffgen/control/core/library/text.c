/* Texts: a fault or a refusal in words and numbers. */
#include "impedance.h"

enum { POWERS = 330, MILLION = 1000000 }; /* of ten, down to the smallest number */
static const double SAME_DIGITS = 1e-6; /* relative difference of two numbers whose digits may be the same */

/* Append characters to a text of the given size, as far as they fit with the final zero. */
static void append(char *text, size_t size, size_t *length, const char *words)
{
    for (size_t k = 0; words[k] != '\0' && *length + 1u < size; ++k) {
        text[*length] = words[k];
        *length += 1u;
    }
    text[*length] = '\0';
}

/* Append a number that is given in millionths, at least 0, without zeros at the end of its decimals. */
static void append_millionths(char *text, size_t size, size_t *length, int64_t millionths)
{
    char digits[24]; /* filled from the end */
    int at = (int)sizeof digits - 1, shown = 0;
    int64_t left = millionths;
    digits[at] = '\0';
    for (int place = 0; place < 7 || left > 0; ++place) { /* six decimals, then at least one digit before the point */
        const int digit = (int)(left % 10);
        if (place == 6 && shown) {
            at -= 1;
            digits[at] = '.';
        }
        shown |= digit != 0 || place >= 6; /* zeros behind the last decimal are left out */
        if (shown) {
            at -= 1;
            digits[at] = (char)('0' + digit);
        }
        left /= 10;
    }
    append(text, size, length, digits + at);
}

/* Append a number with up to six decimals, one below 1e-4 with its power of ten; beyond a billion or NaN a billion. */
static void append_number(char *text, size_t size, size_t *length, double number)
{
    double shown = fabs(number) <= 1e9 ? fabs(number) : 1e9;
    int power;
    for (power = 0; power < POWERS && shown > 0.0 && shown < (power > 0 ? 1.0 : 1e-4); ++power) {
        shown *= 10.0;
    }
    append(text, size, length, number < 0.0 ? "-" : "");
    append_millionths(text, size, length, (int64_t)(shown * 1e6 + 0.5));
    if (power > 0) {
        append(text, size, length, "e-");
        append_millionths(text, size, length, (int64_t)power * MILLION);
    }
}

/* Write what a fault is about into a text: joint, meaning with the fields to look at, what was seen, and its limit. */
void describe_fault(const output_t *out, char *text, size_t size)
{
    size_t length = 0;
    if (size == 0u) {
        return;
    }
    text[0] = '\0';
    if (out->fault_joint >= 0 && out->fault_joint < N) {
        append(text, size, &length, stiffgen_joint(out->fault_joint));
        append(text, size, &length, ": ");
    }
    append(text, size, &length, meaning_of_reason(out->reason));
    if (seen_of_reason(out->reason)[0] != '\0') {
        append(text, size, &length, "; ");
        append(text, size, &length, seen_of_reason(out->reason));
        append(text, size, &length, ": ");
        append_number(text, size, &length, out->fault_seen);
        append(text, size, &length, ", limit ");
        append_number(text, size, &length, out->fault_limit);
    }
}

/* Write a refusal into a text: argument and entry, meaning, what was seen, and its limit. */
void describe_refusal(const output_t *out, char *text, size_t size)
{
    const int entry = out->refusal_entry, command = out->refusal_command;
    size_t length = 0;
    if (size == 0u) {
        return;
    }
    text[0] = '\0';
    append(text, size, &length, name_of_command(command));
    if (command == ID(COMMAND_Q0) && entry >= 0 && entry < N) {
        append(text, size, &length, " of ");
        append(text, size, &length, stiffgen_joint(entry));
    } else if (entry >= 0) {
        append(text, size, &length, ", entry ");
        append_number(text, size, &length, entry);
    }
    append(text, size, &length, command != ID(COMMAND_NONE) ? ": " : "");
    append(text, size, &length, meaning_of_refusal(out->refusal));
    if (entry >= 0 && out->refusal != ID(REFUSAL_NOT_FINITE)) {
        const double apart = fabs(out->refusal_seen - out->refusal_limit);
        append(text, size, &length, "; seen ");
        append_number(text, size, &length, out->refusal_seen);
        append(text, size, &length, ", limit ");
        append_number(text, size, &length, out->refusal_limit);
        if (apart > 0.0 && apart < SAME_DIGITS * fabs(out->refusal_limit)) {
            append(text, size, &length, ", apart by ");
            append_number(text, size, &length, apart);
        }
    }
}
