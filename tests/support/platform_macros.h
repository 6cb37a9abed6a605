/* SPDX-License-Identifier: MIT */
/* Macros that headers of platforms define, as they define them: what includes our files may have included those first. */
#ifndef PLATFORM_MACROS_H
#define PLATFORM_MACROS_H

/* Arduino: Arduino.h, binary.h */
#define min(a, b) ((a) < (b) ? (a) : (b))
#define max(a, b) ((a) > (b) ? (a) : (b))
#define abs(x) ((x) > 0 ? (x) : -(x))
#define round(x) ((x) >= 0 ? (long)((x) + 0.5) : (long)((x)-0.5))
#define constrain(x, low, high) ((x) < (low) ? (low) : ((x) > (high) ? (high) : (x)))
#define radians(x) ((x)*0.017453292519943295)
#define degrees(x) ((x)*57.29577951308232)
#define sq(x) ((x) * (x))
#define bit(b) (1UL << (b))
#define F(text) (text)
#define PI 3.1415926535897932
#define HALF_PI 1.5707963267948966
#define TWO_PI 6.283185307179586
#define EULER 2.718281828459045
#define LOW 0
#define HIGH 1
#define INPUT 0
#define OUTPUT 1
#define CHANGE 1
#define DEFAULT 1
#define EXTERNAL 0
#define SERIAL 0
#define DISPLAY 1
#define B1 1
#define B01 1
#define B10 2

/* Windows: windef.h, rpcndr.h, minwindef.h, winerror.h, wingdi.h, old math.h */
#define near
#define far
#define NEAR
#define FAR
#define small char
#define hyper long
#define interface struct
#define IN
#define OUT
#define OPTIONAL
#define CONST const
#define VOID void
#define TRUE 1
#define FALSE 0
#define ERROR 0
#define NO_ERROR 0
#define STRICT 1
#define INFINITE 0xFFFFFFFF
#define DELETE 0x00010000L
#define IGNORE 0
#define DIFFERENCE 11
#define DOMAIN 1
#define OVERFLOW 3
#define UNDERFLOW 4
#define ABSOLUTE 1
#define RELATIVE 2
#define TRANSPARENT 1
#define OPAQUE 2

/* Apple: AssertMacros.h, objc.h */
#define check(assertion) ((void)(assertion))
#define verify(assertion) ((void)(assertion))
#define require(assertion, label) do { if (!(assertion)) { goto label; } } while (0)
#define nil 0
#define YES 1
#define NO 0

/* GNU: predefined in gnu modes, sys/sysmacros.h, sys/param.h, complex.h */
#define linux 1
#define unix 1
#define major(device) ((device) >> 8)
#define minor(device) ((device)&255)
#define makedev(major_number, minor_number) ((major_number) << 8 | (minor_number))
#define MIN(a, b) ((a) < (b) ? (a) : (b))
#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define howmany(x, y) (((x) + ((y)-1)) / (y))
#define roundup(x, y) ((((x) + ((y)-1)) / (y)) * (y))
#define isset(a, i) ((a)[(i) / 8] & (1 << ((i) % 8)))
#define I _Complex_I
#define complex _Complex

/* termios.h, newlib's ctype.h, curses.h */
#define B0 0000000
#define B50 0000001
#define B75 0000002
#define ECHO 0000010
#define TAB0 0000000
#define _N 04
#define _L 02
#define _U 01
#define _C 040
#define OK 0
#define ERR (-1)
#define erase() 0
#define clear() 0
#define move(y, x) 0
#define timeout(delay) 0
#define scroll(window) 0

/* X11: X.h, Xlib.h */
#define None 0L
#define Status int
#define Success 0
#define Bool int
#define True 1
#define False 0
#define Always 2
#define Above 0
#define Below 1
#define Complex 0
#define Convex 2

/* Qt */
#define signals public
#define slots
#define emit
#define foreach for
#define forever for (;;)

/* Registers and sizes: avr/io.h, sources of drivers and of textbooks */
#define N 3
#define M 4
#define R0 0
#define R1 1
#define XL 26
#define SP 61
#define DEBUG 1
#define VERSION 2
#define RESET 1
#define ENABLE 1
#define FLASH 0
#define PWR 0

#endif
