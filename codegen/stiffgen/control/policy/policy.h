#ifndef POLICY_H
#define POLICY_H

#include "../shared/shared.h"
/* Structs of a robot, which the generator writes: the stub in tests/support/stub_policy. */
#include "robot.h"

enum { PARTS = 4, WHOLE = -1, READY = 0x9011c7 }; /* of a proposal; entry of a refusal of all; mark of start */
enum { ACCEPTED = ID(POLICY_REFUSED_NONE) };

/* Refusal of a part: why, row-major index of the entry or WHOLE, what was seen, and what it may be. */
typedef struct {
    int code, entry;
    double seen, limit;
} refusal_t;

/* ---- functions, by file ---- */
refusal_t accept(void);
refusal_t refuse(int code, int entry, double seen, double limit);
refusal_t check_poses(const config_t *c, const double *poses);
refusal_t check_stiffness(const double *stiffness, double most, double *symmetric);
refusal_t check_wrench(const config_t *c, const double *wrench);
int start(const config_t *c, policy_t *p, const double *poses, double now);
int propose(policy_t *p, const proposal_t *proposal, double now);
void command(policy_t *p, double now, output_t *out);

#endif
