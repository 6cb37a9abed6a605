#ifndef SENSOR_H
#define SENSOR_H

/* The robot's number of joints. The generator writes these functions into NAME_sensor.h, under the robot's name;
 * tests/support/stub_sensor has a robot to compile them by themselves. */
#include "robot.h"

#include <math.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

/* ---- functions, by file ---- */

#endif
