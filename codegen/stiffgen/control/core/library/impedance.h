/*
 * The impedance controller as a C library, independent of the robot. docs/controller.md has the equations,
 * docs/energy.md the theorem. A step has phases, each a file, whose results nothing changes later:
 *   sample = believe(memory, input)              sample.c, watch.c
 *   command = accept_command(memory, input)      command.c
 *   reference = govern(memory, command)          reference.c
 *   wanted = find_law(memory, command)           law.c
 *   torque = guard(memory, wanted)               guard.c
 *   account_...                                  account.c: the only writers of tank, supplied, springs, zones
 * U(q; r, K) is the energy of the springs, with reference r and stiffness K; l, the scale; the torque is that of l U.
 */
#ifndef IMPEDANCE_H
#define IMPEDANCE_H

/* Structs, sizes and the macro ID, which adds the robot's prefix. The generator writes them, and these files with all
 * functions static, into NAME_impedance.c; tests/support/stub_robot has a robot to compile the files by themselves. */
#include "../../shared/shared.h"
#include "robot.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { NO_JOINT = -1, READY = 0x51f7, DELAYS = 6 }; /* DELAYS: torques of the account's history */
enum { LONGEST = 100000 }; /* samples at which a counter stands still: 100 s at 1 kHz, and no overflow */
enum { MOST_TURNS = 2 * N * (N + 1) }; /* of QL: seven joints need 62 on average, 90 at most of 3 000 matrices */

/* Share by which numbers differ that are the same but for rounding: far above what any sum here can lose (1e-13), and
 * far below what matters to an arm. */
static const double ROUNDED = 1e-9;
static const double GOVERNOR = 0.8;  /* share of its velocity limits that a tip's equilibrium uses */
static const double SPEED = 0.72;    /* the same of a joint's reference; damping rises above */
static const double TOLERANCE = 0.1; /* [rad] or [m] beyond a limit that is no fault: calibration, compliance */
static const double FLOOR = 0.1;     /* share of tank_initial that moves, stiffness and scale are not paid from */
static const double COVERED = 0.7;   /* share of the available energy for springs; damping has the remainder */
static const double SCALE_TIME = 0.05; /* [s] shortest time in which the scale rises from 0 to 1 */
static const double NOISE_RANGE = 6.0; /* velocity_noise counts this often in one sample */
static const double TREND_TIME = 0.01; /* [s] by which the trend of the reference is late */
static const double SHAPED = 4.0; /* times the reference's own acceleration that follows a shaped command */
static const double NO_TORQUE = 1e-9; /* [N m] or [N] that counts as none: nothing is divided by it */
static const double TURN = 6.28318530717958648;

/*
 * Finding about sample, arm or command: the reason of a fault or refusal, for a refusal the argument, joint or entry,
 * the number that was seen, and what it may be.
 */
typedef struct {
    int reason, command, entry;
    double seen, limit;
} finding_t;
static const finding_t NOTHING = {0, 0, NO_JOINT, 0.0, 0.0};

/* Sample: what is believed of it, what the checks found, and the records that follow from it. */
typedef struct {
    int good;     /* the sample is believed */
    int periods;  /* sample times since the last call; 0: the clock stands still or is not given */
    double q[N], dq[N];
    finding_t lost, limit, unstable; /* sample or calls; position or speed; dissipation or shaking */
    uint32_t status;
    watch_t watch;
    double joints[LOOP_JOINTS]; /* of closed loops */
} sample_t;

/* Accepted command: positions within the limits and on the reference's turn, stiffnesses symmetric to the last bit. */
typedef struct {
    int accepted, shaped, limited;
    double q0[N];
    stiffness_t stiffness;
    const double *wrench, *acceleration; /* of the input */
    int pressing, planned;               /* there is an accepted wrench, acceleration */
    finding_t refusal;
} command_t;

/* Move of the reference: where it goes, what the springs' energy rises by [J], and its travel [s]. */
typedef struct {
    double r[N], dr[N], equilibrium[16 * TIPS], rise, travel;
    uint32_t status;
} move_t;

/* Stiffness in force next, and the springs' energy with it [J]. */
typedef struct {
    stiffness_t stiffness;
    double energy;
    uint32_t status;
} change_t;

/* Wanted torques: pull, energy are of the springs at scale 1; cap: the scale that sample time and delay allow. */
typedef struct {
    double pull[N], zone[N], damper[N], feedforward[N], energy, cap, press;
    uint32_t status;
} law_t;

/* Scale of the springs. */
typedef struct {
    double scale;
    uint32_t status;
} scale_t;

/* Torque that leaves the controller, without the caller's, where its rate leads it, and calls for which it is held. */
typedef struct {
    double own[N], aim[N], reserve;
    int hold;
    finding_t finding;
    uint32_t status;
} torque_t;

/* Modes of a symmetric matrix: eigenvalues d, and the turns that lead to the eigenvectors. */
typedef struct {
    double d[N], beta[N], side[N], cosine[MOST_TURNS], sine[MOST_TURNS];
    int16_t row[MOST_TURNS]; /* lower row of a turn; negative: ~row is turned round */
    int count;
} modes_t;

/* ---- functions, by file ---- */

/* matrix.c */
int count_up(int x, int by);
void add_scaled(int count, double a, const double *x, double *y);
double mix(int count, const double *a, const double *b, double share, double *result);
int factorise(double *A);
void invert_triangle(double *L);
void form_pencil(const double *inverse, double *K);
void multiply_lower(const double *inverse, const double *x, double *result);
void multiply_upper(const double *inverse, const double *x, double *result);

/* modes.c */
void find_modes(double *A, modes_t *m);
void to_modes(const modes_t *m, const double *A, double *y);
void from_modes(const modes_t *m, const double *A, double *y);

/* springs.c */
double spring_energy(const memory_t *m, const double *q, const double *r, const double *poses, const stiffness_t *K);
double zone_energy(const memory_t *m, const double *q, double *pull, double *slope);
double most_eigenvalue(const config_t *c);
double beyond(const config_t *c, int i, double q);
double nearest_turn(int i, double q, double other);
void mass_with_motors(const memory_t *m, const double *q, double *M);
void place_zones(const memory_t *m, const double *q, arm_t *arm);

/* account.c */
double available(const account_t *a);
int call_gap(const config_t *c);
double reserve(const memory_t *m, const double *torque, double hold);
double covered_share(const memory_t *m, const double *torque, double most);
double budget(const memory_t *m);
void account_open(account_t *a, const config_t *c, const double *torque);
void account_time(account_t *a, const config_t *c, int periods);
void account_interval(account_t *a, const memory_t *m, const double *q, double springs, double zones);
void account_start(account_t *a, const memory_t *m, double zones);
void account_engage(account_t *a, const memory_t *m);
void account_move(account_t *a, const memory_t *m, const move_t *g);
void account_springs(account_t *a, const memory_t *m, double springs);
void account_release(account_t *a);
void account_torque(account_t *a, const torque_t *t);

/* sample.c, watch.c */
void believe(const memory_t *m, const input_t *in, sample_t *s);
void watch_limits(const memory_t *m, sample_t *s);
void watch_shaking(const memory_t *m, sample_t *s);
void calm(watch_t *w);

/* command.c */
finding_t find(int reason, int entry, double seen, double limit);
void accept_command(const memory_t *m, const input_t *in, command_t *k);
finding_t check_clock(const input_t *in);

/* reference.c */
double relative_speed(const config_t *c, const double *x);
void govern(const memory_t *m, const command_t *k, move_t *g);
void stiffen(const memory_t *m, const command_t *k, change_t *next);

/* law.c, feedforward.c */
void find_law(const memory_t *m, const command_t *k, law_t *w);
void feed_forward(const memory_t *m, const command_t *k, const double *inverse, law_t *w);

/* guard.c */
scale_t vary_scale(const memory_t *m, const law_t *w);
void guard(const memory_t *m, const law_t *w, torque_t *t);
void let_fall(const memory_t *m, torque_t *t);
int holds_in_fault(const memory_t *m);
int has_no_torque(int reason);

/* memory.c */
uint64_t compute_checksum(const state_t *state);
int vote(const uint64_t *copies, double *result);
void store_copies(uint64_t *copies, const double *values);
int is_believable(const state_t *state);

/* text.c */
void describe_fault(const output_t *out, char *text, size_t size);
void describe_refusal(const output_t *out, char *text, size_t size);

/* init.c */
int integers_within(const int *x, size_t count, int least, int most);
int initialise(const config_t *c, state_t *state, const double *torque);
int request_reset(state_t *state);

/* step.c */
int step(state_t *state, const input_t *in, output_t *out);

#endif
