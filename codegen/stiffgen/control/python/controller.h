/* ---- controller: structs pass as buffers, and tables of their layout become lists ---- */
#ifndef CONTROLLER_H
#define CONTROLLER_H

/* Python, the robot's name and number of motors, and the structs of its controller. The generator writes them and the
 * tables, and these files with all functions static, into NAME_python.c; tests/support/stub_module has a robot to
 * compile the files by themselves, where C_INCLUDE_PATH names the headers of Python and NumPy. */
#include "controlled_robot.h"

#include <stdint.h>
#include <string.h>

typedef struct {
    const char *structure;
    const char *name;
    const char *format; /* NumPy's */
    size_t offset;
    int rank;
    int extent[3];
    int unbounded; /* whether the field may be infinite */
    const char *unit;
    const char *heading; /* of the section that it begins, or "" */
} field;

typedef struct {
    const char *name;
    size_t size;
} structure;

typedef struct {
    const char *field;
    const char *word;
    int value;
} choice;

typedef struct {
    const char *name;
    unsigned int bit;
    const char *meaning;
} status;

/* ---- functions, by file ---- */

extern const field fields[FIELDS];
extern const structure structures[STRUCTURES];
extern const choice choices[CHOICES], outcomes[OUTCOMES];
extern const status statuses[STATUSES];

void *structs(const Py_buffer *buffer, size_t size, Py_ssize_t count);
int add_controller(PyObject *module);

int add_paper(PyObject *module);

int add_follow(PyObject *module);

int add_policy(PyObject *module);

int add_gains(PyObject *module);

int add_find_posture(PyObject *module);

int add_settle(PyObject *module);

int add_press(PyObject *module);

#endif
