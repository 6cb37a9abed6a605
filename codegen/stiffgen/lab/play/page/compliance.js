// SPDX-License-Identifier: MIT
// An arm on joint springs: its compliance at the tip with and without the load's terms, and the way it gives when pressed.

import { eigen, largest, multiply, norm, plus, transpose } from "./algebra.js";
import { rangeOf } from "./chain.js";
import { originOf } from "./mechanics.js";

export const PUSH = 20; // N, of the ellipsoids
export const PRESS_SECONDS = 4; // of the figure
const GROWING = 3; // s, in which the force grows
const PRESS_STEP = 0.005; // s
const RATE = 40; // 1/s, of a joint that its spring alone draws back
const FALLING = 0.02; // step of a joint [rad or m]
const ROUNDS = 20, PARTS = 120, FARTHER = 1e-4; // of the search for a stretched posture; the last in m
const KICK = 1e-3; // part of each spring's gain, along the softest way: a straight arm has no side to fall to

/** Gains of joint springs: unit, value at the start, most. */
export const GAINS_OF = { turning: { unit: "N m/rad", start: 200, most: 2000 }, sliding: { unit: "N/m", start: 2e4, most: 1e5 } };

/** Return the gains of the joint springs at the start. */
export function softGains(robot) {
  return Float64Array.from(sprung(robot), (k) => GAINS_OF[robot.coordinates[k].prismatic ? "sliding" : "turning"].start);
}

/** Return the coordinates that have a spring: the motors of closed loops, else all. */
export const sprung = (robot) => robot.loops?.actuated ?? robot.coordinates.map((_, k) => k);

/** Return the load's part of the springs' stiffness (m x m) under a wrench (6): the joint stiffness of no task spring. */
function loadPart(tip, q, wrench) {
  const none = new Float64Array(36), { base } = tip;
  const whole = tip.robot.loops
    ? tip.call("motors_joint_stiffness", { q, wrench, task_stiffness: none })
    : tip.jointStiffness(q, wrench, none, true);
  const n = Math.sqrt(whole.length), m = n - base;
  return Float64Array.from({ length: m * m }, (_, k) => whole[(base + Math.floor(k / m)) * n + base + (k % m)]);
}

/** Return the translation's rows (3 x m) of the Jacobian of the joints that have a spring. */
function rowsOfPlace(tip, q) {
  return tip.ofMotors(q, tip.jointColumns(tip.jacobian(q)).slice(0, 3 * tip.coordinates));
}

/** Return the sum of the products a a^T / stiffness over the columns a of A (3 x m): a compliance (3 x 3). */
function summed(A, stiffnesses) {
  const m = stiffnesses.length, over = A.map((value, k) => value / stiffnesses[k % m]);
  return multiply(over, transpose(A, 3, m), 3, m, 3);
}

/**
 * The softness of an arm at q whose joints springs with `gains` (m) hold under a wrench (6):
 *   stability   smallest eigenvalue of H = diag(gains) - the load's part
 *   softest     its eigenvector (m)
 *   usual       J diag(gains)^-1 J^T of the translation (3 x 3) [m/N]
 *   loaded      J H^-1 J^T (3 x 3) [m/N]; null where H is not positive definite
 */
export function softness(tip, q, wrench, gains) {
  const m = gains.length, J = rowsOfPlace(tip, q);
  const H = loadPart(tip, q, wrench).map((value, k) => (k % (m + 1) === 0 ? gains[k / (m + 1)] : 0) - value);
  const { values, vectors } = eigen(H, m), stability = Math.min(...values), least = values.indexOf(stability);
  return {
    stability,
    softest: Float64Array.from({ length: m }, (_, i) => vectors[i * m + least]),
    usual: summed(J, gains),
    loaded: stability > 0 ? summed(multiply(J, vectors, 3, m, m), values) : null,
  };
}

/** Return the gain, the same for each joint, below which an arm gives way at q under a wrench; 0: it never does. */
export function criticalGain(tip, q, wrench) {
  const L = loadPart(tip, q, wrench);
  return Math.max(0, ...eigen(L, Math.sqrt(L.length)).values);
}

/**
 * An arm that stands at q without load, and is pressed: a force grows from zero at its tip and keeps its direction.
 *
 * The arm follows the gradient of its energy, without masses: d(joint)/dt = RATE (J^T f / gain - way of the spring), so it
 * rests where springs and force balance, and falls where it gives way. Its joints stop at their limits.
 * `time` [s], `q`, `share` of the force; `gaveWay`: that share at which H lost its definiteness, or null.
 */
export class Press {
  constructor(tip, q, force, gains) {
    Object.assign(this, { tip, gains, start: q.slice(), q: q.slice(), time: 0, gaveWay: null });
    this.force = Float64Array.of(...force, 0, 0, 0);
    this.springs = sprung(tip.robot);
    this.usual = softness(tip, q, new Float64Array(6), gains).usual;
    this.look();
  }

  get share() {
    return Math.min(1, this.time / GROWING);
  }

  get wrench() {
    return this.force.map((x) => x * this.share);
  }

  /** Return how far the tip has gone [m]: solved, and by the usual formula of the start. */
  ways() {
    const moved = plus(originOf(this.tip.pose(this.q)), originOf(this.tip.pose(this.start)), -1);
    return { loaded: norm(moved), usual: this.share * norm(multiply(this.usual, this.force.slice(0, 3), 3, 3, 1)) };
  }

  /** See how soft the arm is now. */
  look() {
    this.now = softness(this.tip, this.q, this.wrench, this.gains);
    if (this.now.stability <= 0) this.gaveWay ??= this.share;
  }

  /** Go on to a time [s]. */
  advance(until) {
    while (this.time + PRESS_STEP / 2 < until) {
      this.time += PRESS_STEP;
      const pull = multiply(transpose(rowsOfPlace(this.tip, this.q), 3, this.gains.length), this.wrench.slice(0, 3), this.gains.length, 3, 1);
      const kick = this.now.stability > 0 ? 0 : KICK;
      const way = this.springs.map((joint, k) => {
        const back = this.start[joint] - this.q[joint];
        return RATE * PRESS_STEP * (pull[k] / this.gains[k] + back + kick * this.now.softest[k]);
      });
      const shorten = Math.min(1, FALLING / (largest(way) || 1)), next = this.q.slice();
      this.springs.forEach((joint, k) => (next[joint] += shorten * way[k]));
      this.q = this.tip.movedTo(this.q, next);
      this.look();
    }
  }
}

/** Return the smallest and the largest of the lengths [m] by which PUSH moves the tip, by a compliance (3 x 3). */
export function reachOfPush(compliance) {
  const values = eigen(compliance, 3).values.map((value) => PUSH * value);
  return [Math.min(...values), Math.max(...values)];
}

/** Return a posture that stretches the arm: joint after joint goes to where the tip is farthest from the base. */
export function stretched(tip, q) {
  const { coordinates } = tip.robot;
  let best = { far: norm(originOf(tip.pose(q))), q };
  for (let round = 0; round < ROUNDS; ++round) {
    const before = best;
    for (const k of sprung(tip.robot)) {
      const [from, to] = rangeOf(coordinates[k], Math.PI);
      for (let part = 0; part <= PARTS; ++part) {
        const tried = tip.movedTo(best.q, best.q.map((x, i) => (i === k ? from + ((to - from) * part) / PARTS : x)));
        const far = norm(originOf(tip.pose(tried)));
        if (far > best.far + FARTHER) best = { far, q: tried };
      }
    }
    if (best === before) break;
  }
  return best.q;
}

/** Return the force (N) that presses the tip towards the base. */
export function pressing(tip, q, strength) {
  const place = originOf(tip.pose(q));
  return Float64Array.of(...place.map((x) => (-strength * x) / (norm(place) || 1)), 0, 0, 0);
}
