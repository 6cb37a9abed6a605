#ifndef GAINS_H
#define GAINS_H

#include "../shared/shared.h"
/* Number of joints of a robot, which the generator writes: the stub in tests/support/stub_gains. */
#include "robot.h"

/* ---- functions, by file ---- */
int split_torque(const double *q, const double *dq, const double *q_des, const double *dq_des, const double *torque,
                 const double *joint_stiffness, const double *damping, const double *kp_limit, const double *kd_limit,
                 double *tau_ff, double *kp, double *kd);
double work_of_late_host(const double *q, const double *q_des, const double *dq_des, const double *tau_ff,
                         const double *kp, const double *kd, const double *velocity_limit, double hold);

#endif
