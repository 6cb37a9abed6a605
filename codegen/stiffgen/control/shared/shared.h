#ifndef SHARED_H
#define SHARED_H

/* Functions that several of the controller's files use, independent of the robot. The generator writes those that a
 * file uses into it, static. */
#include <float.h>
#include <math.h>
#include <stddef.h>
#include <string.h>

static const double FARTHEST = 1e6; /* [m] or [rad] beyond which a number is a mistake, or has lost its last digits */

static const double RADIAN = 0.2; /* [m] that counts as much as one radian */

static const double JOINT_DAMPING = 0.1; /* [N m s/rad] of every joint, whatever the springs do */

/* ---- functions, by file ---- */

/* vectors.c */
double larger(double x, double y);
double smaller(double x, double y);
double clamp(double x, double least, double most);
double dot(int count, const double *a, const double *b);
double norm(int count, const double *x);
void divide(int count, double divisor, double *x);
int doubles_within(const double *x, size_t count, double least, double most);
int all_finite(const double *x, int count);

/* matrices.c */
double smallest_eigenvalue(const double *K);
void find_triangle(int n, const double *A, double *L);
void solve_triangles(int n, const double *L, double *x);

/* damping.c */
int is_usable(double sample_time, int delay_samples, double damping_ratio, int joints, const double *motor_inertia);
double most_damping(double sample_time, int delay_samples);
double mode_damping(double l, double late, double damping_ratio);

/* ramps.c */
double stopping_speed(double way, double slope, double T);
void steer(const double *wanted, double most, double *velocity);

/* poses.c */
double rotation_error(const double *pose, int *entry);
int has_form_of_pose(const double *pose);
int clean_pose(const double *pose, double *clean);
void compare_pose(const double *from, const double *to, double *twist);
void compare_poses(int count, const double *from, const double *to, double *twists);
void move_pose(const double *twist, double *pose);

#endif
