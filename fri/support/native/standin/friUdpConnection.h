/* SPDX-License-Identifier: MIT */
/* A library in the place of KUKA's, for tests: README.md. The client brings its own connection. */
#ifndef FRI_STANDIN_UDP_CONNECTION_H
#define FRI_STANDIN_UDP_CONNECTION_H

#include "friConnectionIf.h"

#endif
