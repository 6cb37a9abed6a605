/* Texts: a fault or a refusal in words and numbers. */
#include "impedance.h"

enum { DIGITS = 20, DECIMALS = 9 };

/* Text of the given size that is written so far. */
typedef struct {
    char *text;
    size_t size, length;
} writer_t;

/* Append characters, as far as they fit with the final zero. */
static void append(writer_t *w, const char *words)
{
    for (size_t k = 0; words[k] != '\0' && w->length + 1u < w->size; ++k) {
        w->text[w->length] = words[k];
        w->length += 1u;
    }
    w->text[w->length] = '\0';
}

/* Append words and a number with up to nine decimals; beyond a billion, and of NaN, a billion. */
static void append_number(writer_t *w, const char *words, double number)
{
    char digits[DIGITS + 1] = {'\0'}; /* filled from the end */
    int64_t left = (int64_t)((fabs(number) <= 1e9 ? fabs(number) : 1e9) * 1e9 + 0.5);
    int at = DIGITS;
    for (int place = 0; place <= DECIMALS || left > 0; ++place, left /= 10) {
        if (place == DECIMALS && digits[at] != '\0') {
            --at;
            digits[at] = '.';
        }
        if (place >= DECIMALS || digits[at] != '\0' || left % 10 != 0) { /* no zeros at the end */
            --at;
            digits[at] = (char)('0' + left % 10);
        }
    }
    append(w, words);
    append(w, number < 0.0 ? "-" : "");
    append(w, digits + at);
}

/* Write what a fault is about into a text: joint, meaning with the fields to look at, what was seen, and its limit. */
void describe_fault(const output_t *out, char *text, size_t size)
{
    writer_t w = {text, size, 0u};
    if (size == 0u) {
        return;
    }
    if (out->fault_joint >= 0 && out->fault_joint < N) {
        append(&w, stiffgen_joint(out->fault_joint));
        append(&w, ": ");
    }
    append(&w, meaning_of_reason(out->reason));
    if (seen_of_reason(out->reason)[0] != '\0') {
        append(&w, "; ");
        append(&w, seen_of_reason(out->reason));
        append_number(&w, ": ", out->fault_seen);
        append_number(&w, ", limit ", out->fault_limit);
    }
}

/* Write a refusal into a text: argument and entry, meaning, what was seen, and its limit. */
void describe_refusal(const output_t *out, char *text, size_t size)
{
    const int entry = out->refusal_entry, command = out->refusal_command;
    writer_t w = {text, size, 0u};
    if (size == 0u) {
        return;
    }
    append(&w, name_of_command(command));
    if (command == ID(COMMAND_Q0) && entry >= 0 && entry < N) {
        append(&w, " of ");
        append(&w, stiffgen_joint(entry));
    } else if (entry >= 0) {
        append_number(&w, ", entry ", entry);
    }
    append(&w, command != ID(COMMAND_NONE) ? ": " : "");
    append(&w, meaning_of_refusal(out->refusal));
    if (entry >= 0 && out->refusal != ID(REFUSAL_NOT_FINITE)) {
        append_number(&w, "; seen ", out->refusal_seen);
        append_number(&w, ", limit ", out->refusal_limit);
    }
}
