// SPDX-License-Identifier: MIT
// A push that ends: the arm starts at rest where the spring bears the wrench, the wrench vanishes, three laws swing.

import { dot, multiply, plus, solve } from "./algebra.js";

export const SWING_LAWS = ["conventional", "corrected", "exact"];
export const SWING_SECONDS = 3; // of the figure
const STEP = 2.5e-4; // s
const POSTURE = 20; // N m/rad, towards the start, in every law: six numbers of task stiffness leave a redundant arm free

/**
 * The arm under one law from the moment at which the wrench vanishes.
 *
 * M(q) ddq + c(q, dq) = torque - damping M(q) dq - POSTURE (q - q0): gravity is compensated, the law is
 *   exact                     the spring's torque
 *   conventional, corrected   torque at q0 - K (q - q0), with the joint stiffness K (n x n) at q0, held
 * `time` [s], `q`, `dq`; `made` [J]: energy that the law's spring and the masses have now, and that damping has taken,
 * less the spring's energy at the start. Zero, up to the steps of integration, where the law conserves energy.
 */
export class Swing {
  constructor(tip, q, matrices, law, damping) {
    Object.assign(this, { tip, law, damping, start: q.slice(), time: 0, lost: 0, made: 0 });
    this.spring = matrices.spring;
    this.K = matrices[law];
    this.load = this.part(tip.spring("torque", q, this.spring));
    this.stored = this.springEnergy(q);
    this.x = Float64Array.of(...q, ...new Float64Array(q.length), 0);
  }

  get q() {
    return this.x.slice(0, this.start.length);
  }

  /** Return a vector of the joints from a vector with the base's coordinates before it. */
  part(vector) {
    return vector.slice(this.tip.base);
  }

  /** Return the joints' block of a matrix (n x n) as a product with a joint vector. */
  times(M, vector) {
    const whole = new Float64Array(this.tip.n);
    whole.set(vector, this.tip.base);
    return this.part(multiply(M, whole, this.tip.n, this.tip.n, 1));
  }

  springEnergy(q) {
    const dq = plus(q, this.start, -1), posture = (POSTURE / 2) * dot(dq, dq);
    if (this.law === "exact") return this.tip.spring("energy", q, this.spring)[0] + posture;
    return dot(dq, this.times(this.K, dq)) / 2 - dot(this.load, dq) + posture; // of the symmetric part of K
  }

  torque(q) {
    const dq = plus(q, this.start, -1), posture = dq.map((x) => -POSTURE * x);
    if (this.law === "exact") return plus(this.part(this.tip.spring("torque", q, this.spring)), posture);
    return plus(plus(this.load, this.times(this.K, dq), -1), posture);
  }

  /** Return the mass matrix of the joints; a floating base is held. */
  masses(q) {
    const M = this.tip.call("mass_matrix", { q }), { n, base, coordinates: m } = this.tip;
    return Float64Array.from({ length: m * m }, (_, k) => M[(base + Math.floor(k / m)) * n + base + (k % m)]);
  }

  slope(x) {
    const m = this.start.length, q = x.slice(0, m), dq = x.slice(m, 2 * m), M = this.masses(q);
    const velocity = new Float64Array(this.tip.n);
    velocity.set(dq, this.tip.base);
    const bias = this.part(this.tip.call("bias_forces", { q, velocity, gravity: [0, 0, 0] }));
    const momentum = multiply(M, dq, m, m, 1);
    const ddq = solve(M, plus(plus(this.torque(q), bias, -1), momentum, -this.damping));
    return Float64Array.of(...dq, ...ddq, this.damping * dot(dq, momentum));
  }

  /** Integrate up to a time [s], by the classical Runge-Kutta method in steps of 0.25 ms. */
  advance(until) {
    while (this.time + STEP / 2 < until) {
      const a = this.slope(this.x), b = this.slope(plus(this.x, a, STEP / 2));
      const c = this.slope(plus(this.x, b, STEP / 2)), d = this.slope(plus(this.x, c, STEP));
      this.x = this.x.map((x, k) => x + (STEP / 6) * (a[k] + 2 * b[k] + 2 * c[k] + d[k]));
      this.time += STEP;
    }
    const m = this.start.length, dq = this.x.slice(m, 2 * m);
    const kinetic = dot(dq, multiply(this.masses(this.q), dq, m, m, 1)) / 2;
    this.made = kinetic + this.springEnergy(this.q) + this.x[2 * m] - this.stored;
  }
}
