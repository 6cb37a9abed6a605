// SPDX-License-Identifier: MIT
// Joint stiffness by three formulas, the spring behind them, and the work of four laws on a closed loop.

import {
  antisymmetric, blocks, determinant, dot, eigen, identity, largest, multiply, norm, plus, rotationVector, solve, transpose, turn,
} from "./algebra.js";
import { rangeOf, within } from "./chain.js";

/**
 * One tip of a robot: the kernels with everything that does not change from call to call filled in.
 * A floating base stands at the origin of the world; a tool at run time is `tool`, [R p; 0 1].
 */
export class Tip {
  constructor(robot, index, kernels) {
    this.robot = robot;
    this.tip = robot.tips[index];
    this.kernels = kernels;
    this.tool = identity(4);
    this.coordinates = robot.coordinates.length;
    this.base = robot.floating ? 6 : 0; // velocity coordinates before the joints'
    this.n = this.base + this.coordinates;
  }

  call(role, given) {
    const fixed = { base_pose: identity(4), tool_pose: this.tool };
    return this.kernels.call(this.tip.kernels[role], { ...fixed, ...given });
  }

  /** Whether the robot's folder has masses. */
  get hasMasses() {
    return "mass_matrix" in this.tip.kernels;
  }

  /** Return the tip's pose [R p; 0 1] (4 x 4) [m]. */
  pose(q) {
    return this.call("forward_kinematics", { q });
  }

  jacobian(q) {
    return this.call("hybrid_jacobian", { q });
  }

  /** Return the joint stiffness (n x n) [N m/rad] for a wrench and a task stiffness; `corrected` or conventional. */
  jointStiffness(q, wrench, K, corrected) {
    const role = corrected ? "hybrid_joint_stiffness" : "hybrid_joint_stiffness_uncorrected";
    return this.call(role, { q, wrench, task_stiffness: K });
  }

  /** Call a function of a spring {equilibrium, translation_stiffness, rotation_stiffness}, such as its torque. */
  spring(what, q, spring) {
    return this.call(`spring_${what}`, { q, ...spring });
  }

  /** Return the spring whose equilibrium differs from the tip's pose by displacement d and rotation w (base axes). */
  springFrom(pose, d, w, gains) {
    const R = rotationOf(pose), back = transpose(turn(w), 3, 3), R0 = multiply(back, R, 3, 3, 3);
    const p0 = [0, 1, 2].map((i) => pose[4 * i + 3] - d[i]);
    const equilibrium = Float64Array.of(...R0.slice(0, 3), p0[0], ...R0.slice(3, 6), p0[1], ...R0.slice(6, 9), p0[2], 0, 0, 0, 1);
    const seen = (axes, diagonal) => {
      const D = identity(3).map((value, k) => value * diagonal[k % 3]);
      if (axes === "base") return D;
      const A = axes === "tip" ? R : R0;
      return multiply(transpose(A, 3, 3), multiply(D, A, 3, 3, 3), 3, 3, 3);
    };
    return {
      equilibrium,
      translation_stiffness: seen(this.robot.axes.translation, gains.slice(0, 3)),
      rotation_stiffness: seen(this.robot.axes.rotation, gains.slice(3)),
    };
  }

  /**
   * The spring with these gains (6, base axes) [N/m, N m/rad] that holds the arm at q against a wrench (6) [N, N m]:
   * its equilibrium by Newton's method on the kernel's wrench. Null where none does: a spring that softens cannot hold
   * every moment.
   */
  springUnder(q, wrench, gains) {
    const pose = this.pose(q), x = new Float64Array(6);
    const scale = [norm(wrench.slice(0, 3)) + 1, norm(wrench.slice(3)) + 1];
    const residual = (at) => {
      const spring = this.springFrom(pose, at.slice(0, 3), at.slice(3), gains);
      return this.spring("wrench", q, spring).map((value, k) => (value - wrench[k]) / scale[k < 3 ? 0 : 1]);
    };
    for (let k = 0; k < 6; ++k) x[k] = wrench[k] / gains[k];
    const angle = norm(x.slice(3));
    if (angle > 1) for (let k = 3; k < 6; ++k) x[k] /= angle;
    let left = residual(x);
    for (let round = 0; round < 40 && largest(left) > 1e-13; ++round) {
      const slope = new Float64Array(36), h = 1e-5;
      for (let k = 0; k < 6; ++k) {
        const step = Float64Array.from({ length: 6 }, (_, i) => (i === k ? h : 0));
        const ahead = residual(plus(x, step)), behind = residual(plus(x, step, -1));
        for (let i = 0; i < 6; ++i) slope[6 * i + k] = (ahead[i] - behind[i]) / (2 * h);
      }
      const way = solve(slope, left);
      if (!way) return null;
      let length = Math.min(1, 0.5 / norm(way.slice(3))), next = null;
      for (; length > 1e-4; length /= 2) {
        const tried = residual(plus(x, way, -length));
        if (largest(tried) < largest(left)) {
          next = tried;
          break;
        }
      }
      if (!next) break; // rounding, or no equilibrium
      x.set(plus(x, way, -length));
      left = next;
    }
    if (!(largest(left) < 1e-10)) return null;
    const spring = this.springFrom(pose, x.slice(0, 3), x.slice(3), gains);
    const K = this.spring("task_stiffness", q, spring);
    return Math.min(...eigen(K, 6).values) > 0 ? spring : null;
  }

  /**
   * Return the joint step (without the base) from q for a twist or velocity `way`, J (rows x n); damped least squares.
   * Passive joints of closed loops follow the motors.
   */
  stepTowards(q, J, way, damping) {
    const rows = way.length, M = this.ofMotors(q, J), n = M.length / rows, T = transpose(M, rows, n);
    const A = multiply(M, T, rows, n, rows);
    for (let k = 0; k < rows; ++k) A[k * rows + k] += damping ** 2;
    const step = multiply(T, solve(A, way), n, rows, 1);
    return this.robot.loops ? multiply(this.motion(q), step, this.coordinates, n, 1) : step;
  }

  /** Return joint positions with the motors at others (all joints of q): closed from q; q itself where nothing closes. */
  movedTo(q, wanted) {
    const inside = within(this.robot, wanted), { loops } = this.robot;
    if (!loops) return inside;
    const closed = this.call("close", { actuated: loops.actuated.map((k) => inside[k]), start: q });
    return closed.every(Number.isFinite) ? closed : q;
  }

  /** Return the columns dq/da of the motors (coordinates x motors), without the base. */
  motion(q) {
    const a = this.robot.loops.actuated.length, kept = [], all = this.call("motors_jacobian", { q });
    for (let i = this.base; i < this.n; ++i) kept.push(...all.slice(i * (this.base + a) + this.base, (i + 1) * (this.base + a)));
    return Float64Array.from(kept);
  }

  /** Return the columns of the motors of a Jacobian of the joints (rows x n); without closed loops the Jacobian. */
  ofMotors(q, J) {
    const { loops } = this.robot, n = this.coordinates;
    return loops ? multiply(J, this.motion(q), J.length / n, n, loops.actuated.length) : J;
  }

  /**
   * Return what the motors feel under a wrench and a task stiffness: torque, stiffness (a x a) with and without the
   * kinematic stiffness of the closure. On a floating base the first six are the base's.
   */
  motors(q, wrench, K) {
    const G = this.call("motors_jacobian", { q }), a = G.length / this.n, given = { q, wrench };
    const Kq = this.jointStiffness(q, wrench, K, true);
    return {
      a,
      torque: this.call("motors_torque", given),
      stiffness: this.call("motors_joint_stiffness", { ...given, task_stiffness: K }),
      without: multiply(transpose(G, this.n, a), multiply(Kq, G, this.n, this.n, a), a, this.n, a),
    };
  }

  /** Return the Jacobian's columns of the joints, without the base. */
  jointColumns(J) {
    const rows = J.length / this.n;
    const kept = [];
    for (let i = 0; i < rows; ++i) kept.push(...J.slice(i * this.n + this.base, (i + 1) * this.n));
    return Float64Array.from(kept);
  }
}

export const rotationOf = (pose) => Float64Array.from([0, 1, 2, 4, 5, 6, 8, 9, 10], (k) => pose[k]);
export const originOf = (pose) => [pose[3], pose[7], pose[11]];

/**
 * Everything that the matrices' panel shows, at a posture q under a wrench, with gains (6, base axes).
 * `chosen`: the formulas take the gains as they are; else the spring's own task stiffness, where there is a spring.
 */
export function stiffnesses(tip, q, wrench, gains, chosen) {
  const spring = tip.springUnder(q, wrench, gains);
  const diagonal = blocks(...[gains.slice(0, 3), gains.slice(3)].map((g) => identity(3).map((v, k) => v * g[k % 3])));
  const K = spring && !chosen ? tip.spring("task_stiffness", q, spring) : diagonal;
  const conventional = tip.jointStiffness(q, wrench, K, false);
  return {
    spring,
    K,
    conventional,
    corrected: tip.jointStiffness(q, wrench, K, true),
    exact: spring && tip.spring("joint_stiffness", q, spring),
    antisymmetric: antisymmetric(conventional, tip.n),
  };
}

/** Return the directions (u, v) of a loop through q: two joints, or joint steps that translate or turn the tip. */
export function loopDirections(tip, q, loop) {
  const unit = (n, k) => Float64Array.from({ length: n }, (_, i) => (i === k ? 1 : 0));
  if (loop.kind === "joints") return loop.joints.map((k) => unit(tip.coordinates, k));
  const J = tip.jointColumns(tip.jacobian(q)), first = loop.kind === "turn" ? 3 : 0;
  return loop.axes.map((k) => tip.stepTowards(q, J, unit(6, first + k), 1e-4));
}

export const POINTS = 120; // of a loop
const FARTHEST = 0.8; // of a joint on a loop [rad or m]

/** Return the loop through q, q + r (sin s u + (1 - cos s) v), or with -s, and its derivatives with respect to s. */
export function closedLoop(tip, q, loop) {
  const [u, v] = loopDirections(tip, q, loop);
  const radius = Math.min(loop.radius, FARTHEST / (2 * Math.max(largest(u), largest(v), 1e-9)));
  const way = loop.reversed ? -1 : 1;
  const at = (phase) => plus(plus(q, u, way * radius * Math.sin(phase)), v, radius * (1 - Math.cos(phase)));
  const tangent = (phase) => plus(u.map((x) => x * way * radius * Math.cos(phase)), v, radius * Math.sin(phase));
  return { at, tangent, radius };
}

export const LAWS = ["conventional", "corrected", "secant", "exact"];

/**
 * Work [J] that each law puts out up to every point of a loop, POINTS + 1 numbers a law; without a spring, none exact.
 *   conventional, corrected   a linear spring whose joint stiffness is the one at q, held
 *   secant                    Kq(q, F) (q0 - q) with the corrected stiffness of each posture, the wrench held
 *   exact                     the torque of the spring, less its load at q
 * The sum over equal steps is exact to rounding for the whole lap, since the integrand is periodic and smooth.
 */
export function loopWork(tip, q, wrench, matrices, loop) {
  const { at, tangent } = loop, { spring, K } = matrices, n = tip.n, first = tip.base;
  const step = (2 * Math.PI) / POINTS, load = spring && tip.spring("torque", q, spring);
  const held = (M, dq) => multiply(M, dq, n, n, 1).map((x) => -x);
  const torque = {
    conventional: (_, dq) => held(matrices.conventional, dq),
    corrected: (_, dq) => held(matrices.corrected, dq),
    secant: (here, dq) => held(tip.jointStiffness(here, wrench, K, true), dq),
    exact: (here) => plus(tip.spring("torque", here, spring), load, -1),
  };
  const works = {};
  for (const law of LAWS) {
    if (law === "exact" && !spring) continue;
    const power = Float64Array.from({ length: POINTS + 1 }, (_, k) => {
      const phase = (k % POINTS) * step, here = at(phase), dq = new Float64Array(n);
      dq.set(plus(here, q, -1), first);
      return dot(torque[law](here, dq).slice(first), tangent(phase));
    });
    works[law] = new Float64Array(POINTS + 1);
    for (let k = 0; k < POINTS; ++k) works[law][k + 1] = works[law][k] + (step * (power[k] + power[k + 1])) / 2;
  }
  return works;
}

/** Return a configuration that bends the arm: near the middle of each joint's range. */
export function bentPosture(robot) {
  return within(
    robot,
    Float64Array.from(robot.coordinates, ({ lower, upper, prismatic }, k) => {
      if (lower === null || upper === null) return prismatic ? 0.1 : 0.6 * (k % 2 ? -1 : 1);
      const middle = (lower + upper) / 2, half = (upper - lower) / 2;
      return prismatic || Math.abs(middle) > 0.5 ? middle : middle + Math.min(0.6, 0.5 * half) * (k % 2 ? -1 : 1);
    }),
  );
}

/** Return the smallest singular value of the joints' Jacobian (m and rad mixed): the distance from a singularity. */
export function distanceFromSingular(tip, q) {
  const J = tip.jointColumns(tip.jacobian(q)), n = tip.coordinates, T = transpose(J, 6, n);
  const few = Math.min(6, n);
  return Math.sqrt(Math.max(0, Math.min(...eigen(n < 6 ? multiply(T, J, n, 6, n) : multiply(J, T, 6, n, 6), few).values)));
}

/** Move the one joint that brings the arm nearest to a singularity, to 2 degrees (or 2 % of its range) before it. */
export function nearSingular(tip, q) {
  let best = { distance: Infinity, q };
  tip.robot.coordinates.forEach((coordinate, k) => {
    const [from, to] = rangeOf(coordinate, Math.PI);
    for (let part = 1; part < 120; ++part) {
      const tried = q.slice();
      tried[k] = from + ((to - from) * part) / 120;
      const distance = distanceFromSingular(tip, tried);
      if (distance < best.distance - 1e-9) best = { distance, q: tried, k, step: Math.min(0.035, 0.02 * (to - from)) };
    }
  });
  if (best.k === undefined) return q;
  const ways = [1, -1].map((sign) => best.q.map((x, k) => (k === best.k ? x + sign * best.step : x)));
  return within(tip.robot, ways.reduce((a, b) => (Math.abs(a[best.k] - q[best.k]) < Math.abs(b[best.k] - q[best.k]) ? a : b)));
}

const LONGEST = 0.12; // step of a joint [rad or m]

/**
 * Return q after a step of the joints: shortened to LONGEST, within the limits, and never through a posture in which the
 * arm is stretched out, where the elbow could come back on its other side. `place(q)` gives the Jacobian (3 x n) of the
 * point that is moved: the determinant of old times new changes its sign where it passes through a loss of rank.
 */
export function guardedStep(tip, q, step, place) {
  const old = place(q), n = old.length / 3, few = Math.min(3, n);
  let factor = Math.min(1, LONGEST / (largest(step) || 1));
  for (let tries = 0; tries < 6; ++tries, factor /= 2) {
    const next = tip.movedTo(q, plus(q, step, factor)), J = place(next);
    const square = n < 3 ? multiply(transpose(old, 3, n), J, n, 3, n) : multiply(old, transpose(J, 3, n), 3, n, 3);
    if (determinant(square, few) >= -1e-12 * (norm(old) * norm(J)) ** few) return next; // rounding, where no rank is full
  }
  return q;
}

/** Move the joints so that the tip approaches a position and an orientation (damped least squares, within limits). */
export function follow(tip, q, place, orientation) {
  for (let round = 0; round < 8; ++round) {
    const pose = tip.pose(q), off = plus(place, originOf(pose), -1);
    const turned = rotationVector(multiply(orientation, transpose(rotationOf(pose), 3, 3), 3, 3, 3));
    if (norm(off) < 1e-5 && norm(turned) < 1e-4) break;
    const J = tip.jointColumns(tip.jacobian(q)), n = tip.coordinates;
    const weight = [1, 1, 1, 0.15, 0.15, 0.15]; // the place before the orientation [m, m/rad]
    const weighted = J.map((value, k) => value * weight[Math.floor(k / n)]);
    const shorten = Math.min(1, 0.1 / (norm(off) || 1));
    const way = Float64Array.from([...off.map((x) => x * shorten), ...turned], (x, k) => x * weight[k]);
    q = guardedStep(tip, q, tip.stepTowards(q, weighted, way, 0.03), (at) => tip.ofMotors(at, tip.jointColumns(tip.jacobian(at)).slice(0, 3 * n)));
  }
  return q;
}
