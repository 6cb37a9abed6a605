/* SPDX-License-Identifier: MIT */
/*
 * Arm with motors, friction, flexible joints, a wall, a clamp, a payload and sensors, under a control law. Compiled for
 * one generated robot: -DROBOT=NAME -DUPPER=NAME_IN_CAPITALS -DJOINTS=DOF, with NAME.h, NAME_impedance.h and headers of
 * the makers of commands included. Everything that changes in time comes in arrays with one row per sample.
 */
#ifndef ARMS_H
#define ARMS_H

#include <stdint.h>

#define JOIN_NAMES(a, b) a##b
#define JOIN(a, b) JOIN_NAMES(a, b)
#define ROBOT_(name) JOIN(ROBOT, _##name)

enum { N = JOINTS, MOST_DELAY = 8 };

typedef struct {
    double motor[N];        /* [kg m^2] inertia of the rotors at the joints */
    double coulomb[N];      /* [N m] friction in motion; half as much again holds at rest */
    double viscous[N];      /* [N m s/rad] */
    double joint_spring[N]; /* [N m/rad] between motor and link; 0: rigid */
    double wall_point[3];
    double wall_normal[3];  /* towards the free side */
    double wall_stiffness;  /* [N/m]; 0: no wall */
    double wall_damping;    /* [N s/m] */
    double wall_friction;   /* of a tip that slides */
    double wall_radius;     /* [m] of a cylinder along wall_axis, through wall_point; negative: inside it; 0: a plane */
    double wall_axis[3];    /* unit vector; 0: a sphere */
    double stop_stiffness;  /* [N m/rad] of the mechanical stops, 0.05 rad beyond the limits; 0: none */
    double position_quantum, velocity_quantum; /* of the sensors; 0: exact */
    double unit[N];         /* of the sensors: 1, or another one that q and dq are mistaken in */
    double sample_time;
    double effort[N], rate[N]; /* limits of the textbook laws' torque [N m], [N m/s] */
    int differences;        /* dq is the difference of q; 0: a sensor of its own */
    int delay;              /* [samples] from the sample to the torque */
    int state_period;       /* [samples] from one new state to the next */
    int clamp_start;        /* sample from which the tip is clamped where it is; -1: never */
    int law;                /* 0: stiffgen, else a law of laws.c */
    int shaped;             /* the goal is a point of a motion that has ramps already */
    int reset_after;        /* [samples] after which a fault is reset; 0: never */
    int makers;             /* 1: pose goes through Settle and Press, then Follow, within the loop; 0: goal is q0 */
    int normal;             /* 1: the axis of Press is the surface's normal, from the sensor */
    double settle_force[2]; /* [N], [N m]; 0: no Settle */
    double wrench_delay;    /* [samples] from a contact to its measurement */
    double wrench_last;     /* sample whose contact the sensor repeats from then on; 0: it works */
    double wrench_gain;     /* of the sensor: 1, or less of one that reads too little */
} plant_t;

/* Arrays of an episode, one row per sample. */
typedef struct {
    const double *goal;        /* N: commanded joint positions */
    const double *pose;        /* 16: commanded pose, for the textbook laws */
    const double *translation; /* 3: diagonal of the stiffness */
    const double *rotation;    /* 3 */
    const double *load;        /* 6: wrench on the tip */
    const double *payload;     /* 1: mass at the tip [kg] */
    const double *noise;       /* N: added to dq */
    const double *offset;      /* N: added to q, after rounding */
    const double *wall;        /* 1: the wall's displacement along its normal [m] */
    const double *press;       /* 5: axis, force [N], search */
    const double *wrench_noise; /* 6: added to the measured contact */
    const uint8_t *sensor;     /* 0 good, 1 lost, 2 call skipped, then the faults of sensor_fault_t */
} inputs_t;

enum { GOOD, LOST, SKIPPED, Q_FROZEN, DQ_FROZEN, DQ_ZERO, DQ_REVERSED, NOT_A_NUMBER, COUNTER_FROZEN, BOTH_FROZEN };

typedef struct {
    double q[N];
    double v[N];
    double motors[N]; /* [rad] motors' positions: what the encoders see */
    double torque[N];
    double pose[16];
    double contact[6];
    double work;
    double supplied;
    double tank;
    double command[16]; /* moved pose that Follow is given */
    double detail[2];   /* error and stage of Press */
    uint32_t status;
    int32_t reason;
    int32_t faulted;
    int32_t saturated;
} row_t;

/* What a textbook law reads, and what it remembers. */
typedef struct {
    double q[N], dq[N], goal[N], pose[16], translation[3], rotation[3];
    double sample_time;
} sample_t;

typedef struct {
    double integral[6];
    double inertia[2]; /* mean inertia of the tip at the start: [kg], [kg m^2] */
    int started;
} memory_t;

typedef struct {
    ROBOT_(follow_state) follow;
    ROBOT_(settle_state) settle;
    ROBOT_(press_state) press;
    double normal[3];
    int started;
} makers_t;

/* What the makers of commands give the controller. */
typedef struct {
    double q0[N], wrench_command[6];
} made_t;

int start_makers(const plant_t *p, const ROBOT_(impedance_config) *config, const double *q, makers_t *m);
void make_command(const plant_t *p, makers_t *m, const inputs_t *in, int k, const double *wrench,
                  const ROBOT_(impedance_output) *last, made_t *made, row_t *row);
void touch_surface(const plant_t *p, const double *place, const double *velocity, double wall, double wall_speed,
                   double *force);
void textbook(int law, const sample_t *sample, memory_t *memory, double *torque);
int factorise(int n, double *A);
void solve(int n, const double *L, double *x);

#endif
