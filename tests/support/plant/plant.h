/* SPDX-License-Identifier: MIT */
/*
 * A rigid arm as a plant, on a generated robot's mass matrix, Jacobian and forward kinematics. Compiled for one robot:
 * -DROBOT=NAME -DUPPER=NAME_IN_CAPITALS -DPLANT_N=COORDINATES, with NAME.h included, and NAME_impedance.h for its
 * controller. With two tips -DPLANT_FIRST=NAME_TIP_ and -DPLANT_SECOND, with a pair of them -DPLANT_PAIR, with tools at run time -DPLANT_TOOLS, with closed
 * loops -DPLANT_START=JOINTS: loads act at the first tip, tools weigh nothing, and q are positions of the motors.
 *
 *     (M(q) + diag(motor)) dv/dt + c(q, v) = torque + push - friction v + J^T load + clamp + stops + hand
 *
 * Gravity is taken as compensated. c_i = sum_jk (dM_ij/dq_k - 1/2 dM_jk/dq_i) v_j v_k from central differences of the mass
 * matrix (step 1e-5 rad, error of M's derivatives about 1e-10). SI units; loads are what the ENVIRONMENT APPLIES TO THE
 * ROBOT at the tip, force and moment in base axes.
 *
 * Integrator: classical Runge-Kutta of fourth order in substeps, everything that acts held or a function of (q, v). The work
 * of each force is integrated along with the motion; `energy_error` is what kinetic energy and work then disagree by.
 */
#ifndef PLANT_H
#define PLANT_H

#define JOIN_NAMES(a, b) a##b
#define JOIN(a, b) JOIN_NAMES(a, b)
#define ROBOT_(name) JOIN(ROBOT, _##name)
#define UPPER_(name) JOIN(UPPER, _##name)

#ifndef PLANT_FIRST
#define FIRST_(name) ROBOT_(name)
#else
#define FIRST_(name) JOIN(PLANT_FIRST, name)
#endif

#ifdef PLANT_SECOND
#define SECOND_(name) JOIN(PLANT_SECOND, name)
enum { N = PLANT_N, TIPS = 2 };
#else
enum { N = PLANT_N, TIPS = 1 };
#endif
#ifdef PLANT_PAIR
enum { SPRINGS = TIPS + 2, TWISTS = TIPS + 1 };
#else
enum { SPRINGS = TIPS, TWISTS = TIPS };
#endif

typedef struct {
    double motor[N];       /* [kg m^2] motor inertia at the joint */
    double friction[N];    /* [N m s/rad] viscous */
    double stop_stiffness; /* [N m/rad] of the hard stops at the URDF's limits, unilateral; 0: none */
    double stop_damping;   /* [N m s/rad] there */
    double clamp_force;    /* [N/m] stiffness of a clamp at the tip */
    double clamp_moment;   /* [N m/rad] */
    double clamp_damping;  /* [s] its damping over its stiffness */
    int substeps;          /* a sample time, 1 or more */
} plant_t;

typedef struct {
    double torque[N];        /* [N m] the robot's own, held */
    double kp[N], kd[N];     /* [N m/rad], [N m s/rad] of the motors' own loops */
    double q_des[N];         /* [rad] position where kp is at rest */
    double push[N];          /* [N m] of the environment, held */
    double load[6];          /* [N, N m] at the tip, base axes */
    double hand_target[N];   /* [rad] a hand that moves the arm there: a spring and damper over the joints */
    double hand_stiffness;   /* [N m/rad] 0: no hand */
    double hand_damping;     /* [N m s/rad] */
    double clamp_pose[16];   /* where the tip is clamped */
    int clamped;
} forces_t;

typedef struct {
    double q[N], v[N];
    double environment_work; /* [J] of load, push, hand, clamp, stops and friction since the start */
    double robot_work;       /* [J] of the robot's own torque */
} motion_t;

/* Poses (4, 4) of all tips; tools: poses of the tools in the tips, or NULL for none. */
void robot_poses(const double *q, const double *tools, double *poses);
/* Hybrid Jacobian (6, N) of the first tip, without a tool. */
void robot_jacobian(const double *q, double *J);
/* The links' mass matrices (N, N) at several q. */
void robot_mass_matrices(int count, const double *q, double *M);
/* How far joint i is beyond its upper (positive) or lower limit (negative); 0 inside, and for motors of closed loops. */
double robot_depth(int i, double q);

void plant_mass_matrix(const plant_t *plant, const double *q, double *M);
void plant_bias(const double *q, const double *v, double *c);
double plant_kinetic_energy(const plant_t *plant, const motion_t *motion);
/* Present wrench of the environment on the tip: load and clamp (6), [N, N m], base axes. */
void plant_tip_wrench(const plant_t *plant, const motion_t *motion, const forces_t *forces, double *wrench);
/* Advance by `duration` seconds. */
void plant_advance(const plant_t *plant, motion_t *motion, const forces_t *forces, double duration);

#endif
