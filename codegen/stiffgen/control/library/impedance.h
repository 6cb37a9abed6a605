/*
 * The impedance controller as a C library, independent of the robot. docs/controller.md has the equations, the theorem
 * and the names used here:
 *   U(q; r, K)   energy of the springs at the tips' poses, with the equilibrium r and the stiffness K
 *   l            scale; the torque is the gradient of l U
 *   s, p, v      energy put in by sampling, by moving the equilibrium, by changing stiffness or scale
 */
#ifndef IMPEDANCE_H
#define IMPEDANCE_H

/* Structs, sizes and the macro ID, which adds the robot's prefix. The generator writes them, and these files with all
 * functions static, into NAME_impedance.c; tests/support/stub_robot has a robot to compile the files by themselves. */
#include "robot.h"

#include <float.h>
#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { NO_JOINT = -1, READY = 0x51f7, RECENT = 8, MOST_DELAY = 5, POSTURES = 32, RISES = 10 };
enum { TIP_ROWS = 6 * TIPS }; /* rows of the Jacobians of all tips */
enum { LONGEST = 1000000 }; /* samples or calls at which a counter stands still: 17 minutes at 1 kHz, and no overflow */
enum { SEARCHED = 40, SEARCH_STEPS = 60 }; /* trials of a search for a posture, steps of a trial */
enum { MATRIX_NOT_FINITE = 1, MATRIX_NOT_POSITIVE, MATRIX_NOT_CONVERGED };

/* Share by which numbers differ that are the same but for rounding: far above what any sum here can lose (1e-13), and
 * far below what matters to an arm. Times, poses and stiffnesses are compared with it, and shares that a bound allows
 * are smaller by it, so that rounding does not break the bound. */
static const double ROUNDED = 1e-9;
static const double NO_TORQUE = 1e-9;       /* [N m] or [N] that counts as none: nothing is divided by it */
static const double COMMAND_TOLERANCE = 1e-6; /* of a commanded stiffness, over its largest entry: single precision */
static const double REACH_MARGIN = 1.0; /* [m] beyond the arm's reach from which on a pose has a mistaken unit */
static const double FARTHEST = 1e6;   /* [rad] beyond it an angle has lost its last digits */
static const double GOVERNOR = 0.8;   /* share of its velocity limits that the equilibrium uses: the arm overshoots */
static const double REACHED = 5e-5;      /* [m] or [rad] up to which a posture has its tips at a pose */
static const double STEP_SHARE = 0.05;   /* of a posture's step that is gone in one call */
static const double TANK_FLOOR = 0.1; /* share of tank_initial that stiffness is not paid from */
static const double TRAVEL_TIME = 1.0; /* [s] of the equilibrium's travel that bring in one engagement limit */
static const double COVERED = 0.7;    /* share of the available energy for the springs; the damping has the remainder */
static const double NOISE_RANGE = 6.0; /* velocity_noise counts this often in one sample */
static const double SCALE_TIME = 0.05;   /* [s] shortest time in which the scale rises from 0 to 1 */
static const double NO_LOAD = 1e-3; /* share of heaviest_wrench up to which springs count as unloaded */
static const double HALF_TURN = 3.14159265358979324;

/* Why a command is refused: the first reason, argument and entry, the number that was seen, and what it may be. */
typedef struct {
    int code, command, entry;
    double seen, limit;
} refusal_t;

/* Data of one call of step. */
typedef struct {
    const config_t *c;
    memory_t *m;
    double *scratch; /* 2 N^2 numbers, and behind them the modes of the last design but two */
    double *modes;   /* modes of the last two designs */
    const input_t *input;
    output_t *out;
    uint32_t status;
    int believed;  /* the sample is believed */
    int located;   /* the sample's position is believed, which is enough in a fault */
    int jumped;    /* the position is out of reach from the last known one */
    int condemned[N]; /* the joint's position is not believed: the limit avoidance does not act on it */
    int commanded; /* the command is accepted */
    int pressing;  /* a wrench_command is accepted */
    int planned;   /* velocity and acceleration of a plan are accepted, and in force */
    int held;      /* a fault is latched, and the springs hold the arm */
    int started;   /* an engagement starts in this call */
    int has_external; /* the environment's torque on each joint is known */
    int timed;     /* the sample's counter tells which calls are missing */
    int joint;     /* of the finding about the sample, or NO_JOINT */
    double seen, limit; /* of the finding */
    double lack;   /* [J] that the tank receives if the engagement that starts is paid */
    double budget; /* [J] the tank's share for what costs energy */
    double tank_initial, engagement_limit, energy_limit; /* [J] in force */
    refusal_t refusal; /* of the command */
    int limited;       /* first joint whose q0 is beyond its limit and followed to the zone there, or NO_JOINT */
    double q[N];       /* of the sample; turns of continuous joints are counted */
    double q0[N];      /* of the accepted command, within the joint limits */
    double goal[16 * TIPS]; /* equilibrium of an accepted command by pose; of one by q0 its poses, where they count */
    double old_equilibrium[16 * TIPS];
    double translation[9 * TIPS], rotation[9 * TIPS]; /* stiffness of an accepted command */
    double moved[TIP_ROWS]; /* twists from the poses of the last command to those of this one */
    double away[TIP_ROWS];  /* twists from the equilibrium to the poses of the command */
    double velocity[N];
    int stands[N];    /* the joint stands still, with differenced velocities */
    double range[N];  /* [N m] of the torque under which the position is the same to the last bit; 0: not for long */
    double travel[N]; /* [rad] or [m] predicted for joints that stand still, with differenced velocities */
    double limit_slope[N]; /* [N m/rad] stiffness of the limit avoidance in force */
    double elapsed;        /* [s] from the sample before */
    double motor_damping[N]; /* [N m] kd times the velocity of the damping: the motors take it away again */
    double carried[N];     /* [N m] torque of the plan's acceleration and Coriolis forces */
    double brake[N];       /* [N m s/rad] damping that one joint may still receive */
    double before[N];      /* [N m] torque of the last call, with the caller's */
    double effort[N];      /* [N m] largest torque that can be in force */
    double transit[N];     /* [N m] torque of the last call, 0 where its work is booked already */
    double tip_energy;     /* [J] energy of the tips' springs at the sample, before the equilibrium moves; unscaled */
    double jacobians[6 * N * TIPS]; /* of the tips at the sample, with the tool in force */
    int has_jacobians;              /* the Jacobians are computed */
} step_t;

/* ---- functions, by file ---- */

/* robot.c: the robot's kernels at its tips, one after the other, and the tables of its fields. m: tools of the tips,
 * and with closed loops the joints from which they are closed */
void stiffgen_poses(const double *q, const memory_t *m, double *pose);
void stiffgen_jacobians(const double *q, const memory_t *m, double *jacobian);
double stiffgen_spring_energy(const double *q, const memory_t *m, const double *equilibrium,
                              const double *translation_stiffness, const double *rotation_stiffness,
                              const double *limits);
double stiffgen_spring(const double *q, const memory_t *m, const double *equilibrium,
                       const double *translation_stiffness, const double *rotation_stiffness, const double *limits,
                       double *wrench, double *torque, double *joint_stiffness);
int stiffgen_has_bounded_spring(void);
void stiffgen_mass_matrix(const double *q, const memory_t *m, double *mass_matrix);
void stiffgen_coriolis(const double *q, const memory_t *m, const double *velocity, double *forces);
void stiffgen_home(memory_t *m);
int stiffgen_reaches(const double *q, const memory_t *m);
int stiffgen_follow(const double *q, memory_t *m);
void stiffgen_retract(const memory_t *m, double *q);
int stiffgen_turns(int joint);
const double *stiffgen_tool(const input_t *input);
double stiffgen_reach(int tip, const double *tool);
const double *stiffgen_translation_axes(const double *pose, const double *equilibrium);
const double *stiffgen_rotation_axes(const double *pose, const double *equilibrium);
const double *stiffgen_centre(void);
int check_fields(const config_t *c);
int fault_of_reason(int reason);
const char *meaning_of_reason(int reason);
const char *seen_of_reason(int reason);
const char *stiffgen_joint(int joint);
const char *meaning_of_refusal(int refusal);
const char *name_of_argument(int argument);
void report_memory(const memory_t *m, output_t *out);
int fits_memory(const memory_t *m);

/* matrix.c */
double larger(double x, double y);
double smaller(double x, double y);
double clamp(double x, double least, double most);
int clamp_count(int x, int most);
double dot(int count, const double *a, const double *b);
double norm(int count, const double *x);
void multiply_rows(int n, const double *rows, const double *A, double *result);
void add_scaled(int count, double a, const double *x, double *y);
void multiply_vector(const double *A, const double *x, double *result);
void multiply3(const double *A, int a, int transposed, const double *B, int b, double *C);
double largest_entry(int count, const double *A);
double largest_diagonal(int n, const double *A);
void transpose(int rows, int n, const double *A, double *result);
void scale_columns(int rows, int n, const double *factors, double *A);
void multiply_transposed(int rows, int n, const double *X, double *result);
void form_congruence(int rows, int n, double *Y, const double *d, double *result);
int factorise_cholesky(int n, const double *A, double scale, double shift, double *L);
void solve_forward(int n, const double *L, double *x);
void solve_rows(int n, int count, const double *L, double *X);
void solve_backward(int n, const double *L, double *x);
int solve_damped(int n, const double *A, double shift, double *x);
int is_positive_semidefinite(int n, const double *A, double tolerance);

/* sampling.c */
double find_velocity_delay(const config_t *c, const memory_t *m);
double largest_damping(const config_t *c, const memory_t *m);
double largest_eigenvalue(const config_t *c, const memory_t *m);

/* eigen.c */
void sort_eigenpairs(int n, double *d, double *rows);
int diagonalise_symmetric(int n, double *A, double *d, double *rows);
double find_largest_eigenvalue(const double *A);

/* modes.c */
void take_symmetric_part(int n, const double *K, double *result);
int solve_modes(int n, const double *K, const double *M, double *work, double *eigenvalues, double *modes);
int refine_modes(int n, const double *K, const double *M, double *work, double *eigenvalues, double *modes);
int solve_pencil(int n, const double *K, const double *M, double *L, double *C, double *eigenvalues, double *rows,
                 double *scale);
void multiply_lower(int n, const double *L, double *rows);
int soften(const double *wanted, double share, double *K, double *cost);

/* strength.c */
const double *find_jacobians(step_t *s);
double spread_joint(int k, int i);
void place_posture(const config_t *c, const memory_t *m, int k, double *q);
void place_no_tools(double *tool);
double solve_share(double a, double b, double most);
double size_tank(const config_t *c, const memory_t *m);
void find_energies(step_t *s);
void note_load(step_t *s, double energy);
void report_force(step_t *s);

/* cap.c */
void compute_inertia(const config_t *c, const memory_t *m, const double *q, double *M);
void cap_springs(step_t *s);
int halves_stiffness(const config_t *c, const memory_t *m, double *work);

/* refusal.c */
int refuse_command(refusal_t *r, int code, int command, int entry, double seen, double limit);
int accept_stiffness(const double *K, double most, int command, int tip, double *accepted, refusal_t *r);
int accept_pose(const double *pose, double reach, int command, int tip, double *accepted, refusal_t *r);
int accept_wrench(const config_t *c, const double *wrench, int tip, refusal_t *r);
int accept_command(step_t *s);

/* state.c */
int doubles_within(const double *x, size_t count, double least, double most);
int integers_within(const int *x, size_t count, int least, int most);
int validate(const config_t *c);
uint64_t compute_checksum(const state_t *state);
int vote(const uint64_t *copies, double *result);
void store_copies(uint64_t *copies, const double *values);
void start_memory(const config_t *c, state_t *state, const double *torque);
int initialise(const config_t *c, state_t *state, const double *torque);
int request_reset(state_t *state);
void latch_fault(memory_t *m, int reason, int joint, double seen, double limit);
int holds_in_fault(const step_t *s);
int is_believable(const state_t *state);

/* joint_gains.c */
int split_torque(const double *q, const double *dq, const double *q_des, const double *dq_des, const double *torque,
                 const double *joint_stiffness, const double *damping, const double *kp_limit, const double *kd_limit,
                 double *tau_ff, double *kp, double *kd);
double bound_late_work(const double *q, const double *q_des, const double *dq_des, const double *tau_ff,
                       const double *kp, const double *kd, const double *speed, double hold);
void plan_gains(step_t *s);
double absorbed_work(const memory_t *m, const double *motion);
void fade_gains(memory_t *m);
void limit_gains(step_t *s, int refused);
void report_gains(const step_t *s, int refused);

/* energy.c */
const double *find_spring_limits(const memory_t *m);
double compute_tip_energy(const memory_t *m, const double *q, const double *equilibrium);
double add_posture_energy(const memory_t *m, const double *q, const double *posture, double tips);
double compute_stored_energy(const memory_t *m, const double *q);
double evaluate_avoidance(const double *a, double q, double *pull, double *stiffness);
double distance_beyond(const config_t *c, int i, double q);
double nearest_turn(const step_t *s, int i, double q, double other);
double evaluate_limits(step_t *s, const double *q);
void pay_into_tank(step_t *s, double income);
void book_stiffness(step_t *s, double *energy, double v);
void book_reference(step_t *s, double p);
void shift_history(memory_t *m, const double *last, const double *feed);
double farthest_motion(const memory_t *m, int i);
double worst_feed_work(const memory_t *m, const double *feed, int intervals);
int limit_call_gap(const config_t *c, int missed);
double sum_reserve(const step_t *s, double hold, int gap, const double *torque, double *parts);
double compute_reserve(const step_t *s, int calls, int gap, const double *torque, double *parts);
double available_energy(const memory_t *m);
void adopt_limits(step_t *s, const double *q);
void drop_limits(step_t *s, const double *q);
void adopt_raised_limits(step_t *s, const double *last);
void bridge_gap(step_t *s, int periods);
void note_untimed_call(step_t *s, const double *last);
void bridge_missing_calls(step_t *s, const double *last, int missing);
void book_interval(step_t *s, const double *q);

/* motion.c */
void predict_standstills(step_t *s, const double *last, double elapsed);
void learn_friction(step_t *s, const double *last);

/* sample.c */
void observe_sample(step_t *s, const double *last);

/* posture.c */
void pose_difference(const double *from, const double *to, double *twist);
double largest_part(const double *twists);
double compare_poses(const double *from, const double *to, double *twists);
void move_pose(const double *pose, const double *twist, double *moved);
double find_posture_step(const config_t *c, const memory_t *m, const double *q, const double *error,
                         const double *wanted, double *step);
void step_to_wanted(const memory_t *m, const double *q0, double distance, const double *goal, double *step);
int is_far_behind(const memory_t *m);
int leads_away(const memory_t *m, const double *step);
double find_depth(const memory_t *m, int i, double side);
int is_pushed_out(const step_t *s);
int search_posture(const config_t *c, const double *poses, const double *tool, const double *start, double *posture);

/* governor.c */
double travel_between(const config_t *c, const double *posture, const double *goal, const double *twists);
void move_equilibrium(step_t *s);
void settle_springs(step_t *s);
void pay_engagement(step_t *s);

/* stiffness.c */
void vary_stiffness(step_t *s);
void vary_scale(step_t *s, const double *pull, double energy, double cap);

/* damping.c */
void measure_inertia(step_t *s, const double *q);
double design_damping(step_t *s);
void follow_twists(step_t *s, const double *twists, double *velocity);
void smooth_velocity(step_t *s);
void brake_fast_joints(step_t *s);

/* feedforward.c */
void accept_feedforward(step_t *s);
void follow_plan(step_t *s, int moved);
void press_tips(step_t *s);
void compensate_coriolis(step_t *s);

/* torque.c */
void step_towards_zero(const double *last, const double *rate, double *torque);
void limit_torque(step_t *s, const double *last);
void compute_torque(step_t *s, const double *last, int moved);
void separate_torque_offset(step_t *s, double *last, int refused);
void add_torque_offset(step_t *s, const double *last, int refused);

/* policy.c */
int start_policy(policy_t *p, const double *poses, double now);
int propose(const config_t *c, policy_t *p, const proposal_t *proposal, double now);
void write_command(policy_t *p, double now, input_t *input);

/* text.c */
void describe_fault(const output_t *out, char *text, size_t size);
void describe_refusal(int refusal, int argument, int entry, double seen, double limit, char *text, size_t size);

/* step.c */
int step(const config_t *c, state_t *state, const input_t *input, output_t *output);

#endif
