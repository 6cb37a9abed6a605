#ifndef CARRY_H
#define CARRY_H

/* The part of Follow for robots of several tips. The generator writes it into NAME_follow.c behind Follow's own
 * functions, static; tests/support/stub_carry has a robot to compile it by itself. */
#include "../follow/follow.h"

/* ---- functions, by file ---- */

int carry(state_t *s, const input_t *input, output_t *out);

#endif
