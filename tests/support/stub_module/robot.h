/* SPDX-License-Identifier: MIT */
/*
 * The golden iiwa14, as far as the C of its Python module needs it, to compile codegen/stiffgen/core/emit/python/library by
 * itself. Sizes of tables are examples.
 */
#ifndef ROBOT_H
#define ROBOT_H

#define PY_SSIZE_T_CLEAN
#include <Python.h>

#define NPY_NO_DEPRECATED_API NPY_1_22_API_VERSION
#define NPY_TARGET_VERSION NPY_1_22_API_VERSION
#include <numpy/arrayobject.h>
#include <numpy/ufuncobject.h>

#include "iiwa14.h"

#define ROBOT "iiwa14"
#define SOURCES "digest of the sources"
#define ASYMMETRIC_TEXT "a stiffness is not symmetric"

typedef double number;
static const int NUMBER = NPY_DOUBLE;
enum { POSITIONS = 7, KERNELS = 50, MAX_OPERANDS = 9 };
static const number ASYMMETRY = 1e-9;

#endif
