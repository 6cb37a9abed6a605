// SPDX-License-Identifier: MIT
// A body on a ball joint under three drives: position drives about three axes, and the gradients of two energies.

import { multiply, norm, plus, rotationVector, transpose, turn } from "./algebra.js";

export const DRIVE_SECONDS = 6; // of the figure
const INERTIA = 0.01, GAIN = 10, PUSHED = 0.027; // kg m^2, N m/rad, rad across the target
const DRIVE_STEP = 5e-4; // s

/**
 * The drives: name of the colour, words, and the torque about the body's axes over GAIN at the rotation R (9), with the
 * target's rotation R0 and its rotation vector c.
 */
export const DRIVES = [
  { law: "conventional", words: "three drives", torque: (R, R0, c) => plus(c, rotationVector(R), -1) },
  { law: "exact", words: "rotation vector", torque: (R, R0) => rotationVector(between(R0, R)).map((x) => -x) },
  { law: "secant", words: "trace", torque: (R, R0) => axial(between(R0, R)).map((x) => -x) },
];

/** Return R0^T R: the rotation from the target to the body, in the axes of either. */
const between = (R0, R) => multiply(transpose(R0, 3, 3), R, 3, 3, 3);

/** Return the axis of a rotation times the sine of its angle. */
const axial = (R) => [(R[7] - R[5]) / 2, (R[2] - R[6]) / 2, (R[3] - R[1]) / 2];

/** Return the damping ratio below which three position drives flutter about a target [rad] (docs/theory.md). */
export function flutterLimit(target) {
  return target < 1e-6 ? 0 : target / (4 * Math.sqrt(target / 2 / Math.tan(target / 2)));
}

/** The body from rest, turned by a push about x from its target, a turn about z: `time` [s], `rotation`, `angle()` [rad]. */
export class Body {
  constructor({ law, words, torque }, target, ratio) {
    Object.assign(this, { law, words, torque, time: 0, target: [0, 0, target], velocity: [0, 0, 0] });
    this.damping = 2 * ratio * Math.sqrt(GAIN * INERTIA);
    this.aim = turn(this.target);
    this.rotation = multiply(this.aim, turn([PUSHED, 0, 0]), 3, 3, 3);
  }

  /** Return the angle from the target [rad]. */
  angle() {
    return norm(rotationVector(between(this.aim, this.rotation)));
  }

  /** Return the angular acceleration (body axes); all moments of inertia are equal. */
  acceleration(rotation, velocity) {
    return this.torque(rotation, this.aim, this.target).map((x, k) => (GAIN * x - this.damping * velocity[k]) / INERTIA);
  }

  /** Go on to a time [s]: the velocity first half a step, then the rotation, then the velocity again. */
  advance(until) {
    while (this.time + DRIVE_STEP / 2 < until) {
      const half = plus(this.velocity, this.acceleration(this.rotation, this.velocity), DRIVE_STEP / 2);
      this.rotation = multiply(this.rotation, turn(half.map((x) => DRIVE_STEP * x)), 3, 3, 3);
      const slowed = DRIVE_STEP / 2 / INERTIA;
      const torque = this.torque(this.rotation, this.aim, this.target);
      this.velocity = half.map((x, k) => (x + slowed * GAIN * torque[k]) / (1 + slowed * this.damping));
      this.time += DRIVE_STEP;
    }
  }
}
