/* Texts: a fault in words and numbers. */
#include "impedance.h"

/* Append characters to a text of the given size, as far as they fit with the final zero. */
static void append(char *text, size_t size, size_t *length, const char *words)
{
    for (size_t k = 0; words[k] != '\0' && *length + 1u < size; ++k) {
        text[*length] = words[k];
        *length += 1u;
    }
    text[*length] = '\0';
}

/* Append a number with up to six decimals; beyond a billion, a billion. */
static void append_number(char *text, size_t size, size_t *length, double number)
{
    char digits[24];
    int at = (int)sizeof digits - 1, shown = 0;
    int64_t millionths = (int64_t)(clamp(fabs(number), 0.0, 1e9) * 1e6 + 0.5);
    append(text, size, length, number < 0.0 && millionths > 0 ? "-" : "");
    digits[at] = '\0';
    for (int place = 0; place < 7 || millionths > 0; ++place) {
        const int digit = (int)(millionths % 10);
        if (place == 6 && shown) {
            at -= 1;
            digits[at] = '.';
        }
        shown |= digit != 0 || place >= 6;
        if (shown) {
            at -= 1;
            digits[at] = (char)('0' + digit);
        }
        millionths /= 10;
    }
    append(text, size, length, digits + at);
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
