// SPDX-License-Identifier: MIT
// Two tips hold a box by the springs of their pair: where they rest, and the work of two laws on a lap.

import { cross, dot, identity, multiply, norm, plus, rotationVector, solve, transpose, turn } from "./algebra.js";
import { rangeOf, within } from "./chain.js";
import { originOf, rotationOf } from "./mechanics.js";

export const LAP_POINTS = 240;
export const PAIR_LAWS = ["conventional", "exact"]; // K times the rotation vector; the spring of the pair
const BETWEEN = { translation: [400, 300, 500], rotation: [30, 20, 10] }, ABSOLUTE = { translation: 800, rotation: 40 };
const REST_ROUNDS = 40, REST_STEP = 0.2, AT_REST = 1e-6; // steps; of a joint [rad or m]; N m or N
const DAMPING = { start: 0.1, least: 1e-3, most: 1e7 }; // N m/rad
const LAGGING = 2.4; // rad, by which each joint swings behind the one before
const SLIDE = 0.3; // m/rad, of a sliding joint on a lap
const GAP = 0.24, SIDE = 0.08; // widths of the box, as parts of the arm's reach

const diagonal = (values) => identity(3).map((one, k) => one * values[k % 3]);

/** Return the pose [R p; 0 1] of a rotation (9) and an origin (3). */
export const poseOf = (R, p) => Float64Array.of(...R.slice(0, 3), p[0], ...R.slice(3, 6), p[1], ...R.slice(6, 9), p[2], 0, 0, 0, 1);

/** Return the inverse of a pose. */
export function inverse(pose) {
  const T = transpose(rotationOf(pose), 3, 3);
  return poseOf(T, multiply(T, originOf(pose), 3, 3, 1).map((x) => -x));
}

/** Return the product of two poses. */
export const after = (A, B) => multiply(A, B, 4, 4, 4);

/** Return the shortest rotation that brings a direction to another one. */
function shortest(from, to) {
  const axis = cross(from, to), sine = norm(axis), angle = Math.atan2(sine, dot(from, to));
  if (sine > 1e-9) return turn(axis.map((x) => (x * angle) / sine));
  const other = cross(from, Math.abs(from[0]) < 0.9 ? [1, 0, 0] : [0, 1, 0]), size = norm(other);
  return turn(other.map((x) => (angle > 1 ? (x * Math.PI) / size : 0)));
}

/** The hands A and B of a robot's pair, their springs, and the joints that move them. */
export class Hands {
  constructor(robot, tips) {
    Object.assign(this, { robot, both: robot.pair.tips.map((k) => tips[k]), kernels: robot.pair.kernels });
    [this.n, this.base] = [this.both[0].n, this.both[0].base];
    this.between = { translation: diagonal(BETWEEN.translation), rotation: diagonal(BETWEEN.rotation) };
  }

  call(role, given) {
    const tools = Float64Array.of(...this.both[0].tool, ...this.both[1].tool);
    return this.both[0].kernels.call(this.kernels[role], { base_pose: identity(4), tool_poses: tools, ...given });
  }

  poses(q) {
    return this.both.map((hand) => hand.pose(q));
  }

  /** Return the spring between the hands: rest pose of B in A, stiffnesses. */
  spring(grasps) {
    const { translation, rotation } = this.between;
    return { rest: after(inverse(grasps[0]), grasps[1]), translation_stiffness: translation, rotation_stiffness: rotation };
  }

  /** Return the springs between and of the hands that hold a box of this pose by the `grasps` (poses of the hands in the box). */
  springs(box, grasps) {
    const [a, b] = grasps.map((grasp) => after(box, grasp)), { rest } = this.spring(grasps);
    const middle = plus(originOf(a), originOf(b)).map((x) => x / 2), { translation, rotation } = this.between;
    return {
      equilibrium: poseOf(rotationOf(a), middle), rest,
      translation_stiffness: diagonal(Array(3).fill(ABSOLUTE.translation)), rotation_stiffness: diagonal(Array(3).fill(ABSOLUTE.rotation)),
      relative_translation_stiffness: translation, relative_rotation_stiffness: rotation,
    };
  }

  /** Return the joints at a limit towards which a torque presses. */
  stuck(q, torque) {
    const { coordinates } = this.robot;
    return Array.from(q.keys()).filter((k) => {
      const { lower, upper } = coordinates[k];
      return (torque[k] < 0 && lower !== null && q[k] <= lower) || (torque[k] > 0 && upper !== null && q[k] >= upper);
    });
  }

  /** Return the joint positions, from q on, at which the springs rest: Newton's method, damped, within the limits. */
  rest(q, box, grasps) {
    const springs = this.springs(box, grasps), { n, base } = this, m = n - base;
    let { start: damping } = DAMPING, energy = this.call("bimanual_energy", { q, ...springs })[0];
    for (let round = 0; round < REST_ROUNDS; ++round) {
      const torque = this.call("bimanual_torque", { q, ...springs }).slice(base), stuck = this.stuck(q, torque);
      stuck.forEach((k) => (torque[k] = 0));
      if (norm(torque) < AT_REST) break;
      const K = this.call("bimanual_joint_stiffness", { q, ...springs });
      const damped = Float64Array.from({ length: m * m }, (_, k) => {
        const i = Math.floor(k / m), j = k % m;
        return i !== j && (stuck.includes(i) || stuck.includes(j)) ? 0 : K[(base + i) * n + base + j];
      });
      for (let k = 0; k < m; ++k) damped[k * (m + 1)] += damping;
      const step = solve(damped, torque), shorten = step ? Math.min(1, REST_STEP / Math.max(...step.map(Math.abs))) : 0;
      const next = within(this.robot, plus(q, step ?? torque, shorten)), less = this.call("bimanual_energy", { q: next, ...springs })[0];
      const better = less < energy;
      if (better) [q, energy] = [next, less];
      damping *= better ? 0.3 : 10;
      if (damping > DAMPING.most) break;
      damping = Math.max(damping, DAMPING.least);
    }
    return q;
  }

  /** Return the poses of the box that A and B claim, each by its grasp. */
  claims(q, grasps) {
    return this.poses(q).map((pose, k) => after(pose, inverse(grasps[k])));
  }

  /** Return the pose of the box as the hands hold it: half-way between their claims. */
  boxOf(q, grasps) {
    const [a, b] = this.claims(q, grasps);
    const away = rotationVector(multiply(transpose(rotationOf(a), 3, 3), rotationOf(b), 3, 3, 3));
    const middle = plus(originOf(a), originOf(b)).map((x) => x / 2);
    return poseOf(multiply(rotationOf(a), turn(away.map((x) => x / 2)), 3, 3, 3), middle);
  }

  /**
   * Bring the hands of an arm at q to the two ends of a box between them, their z axes into it as far as they come.
   * Gives {q, box (pose; its x axis from A to B), grasps, half (sizes from the middle [m])}.
   */
  grasp(q, reach) {
    const poses = this.poses(q), [pa, pb] = poses.map(originOf), middle = plus(pa, pb).map((x) => x / 2);
    const apart = plus(pb, pa, -1), far = norm(apart), x = far > 1e-6 ? apart.map((each) => each / far) : [1, 0, 0];
    const up = Math.abs(x[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0], side = cross(up, x), y = side.map((each) => each / norm(side)), z = cross(x, y);
    const box = poseOf(transpose(Float64Array.of(...x, ...y, ...z), 3, 3), middle), half = (GAP * reach) / 2;
    const wanted = poses.map((pose, k) => {
      const sign = k ? -1 : 1, R = rotationOf(pose), inwards = shortest([R[2], R[5], R[8]], x.map((each) => sign * each));
      return after(inverse(box), poseOf(multiply(inwards, R, 3, 3, 3), plus(middle, x, -sign * half)));
    });
    const held = this.rest(q, box, wanted), at = this.boxOf(held, wanted);
    const grasps = this.poses(held).map((pose) => after(inverse(at), pose));
    const ends = grasps.map((each) => Math.abs(each[3]));
    return { q: held, box: at, grasps, half: [(ends[0] + ends[1]) / 2, (SIDE * reach), (SIDE * reach)] };
  }

  /** Return the wrenches on A and B (12) of the usual law: K times displacement and rotation vector of B seen from A. */
  usual(q, { rest, translation_stiffness: Kt, rotation_stiffness: Ko }) {
    const [a, b] = this.poses(q), seen = after(inverse(rest), after(inverse(a), b));
    const axes = multiply(rotationOf(a), rotationOf(rest), 3, 3, 3), turned = rotationVector(rotationOf(seen));
    const [f, m] = [[Kt, originOf(seen)], [Ko, turned]].map(([K, way]) => Array.from(multiply(axes, multiply(K, way, 3, 3, 1), 3, 3, 1)));
    const lever = plus(originOf(b), originOf(a), -1);
    return [...[...f, ...plus(m, cross(lever, f))].map((x) => -x), ...f, ...m];
  }

  /** Return the lap through q on which each joint swings by `radius` [rad], or by less near its limits. */
  lap(q, radius) {
    const begin = q.map((_, k) => Math.cos(LAGGING * k));
    const swings = q.map((x, k) => {
      const coordinate = this.robot.coordinates[k], [lower, upper] = rangeOf(coordinate, 2 * Math.PI);
      const room = Math.min((upper - x) / (1 - begin[k] || 1), (x - lower) / (1 + begin[k])); // the first one begins at its end
      return Math.max(0, Math.min(radius * (coordinate.prismatic ? SLIDE : 1), room));
    });
    const at = (phase) => q.map((x, k) => x + swings[k] * (Math.cos(phase + LAGGING * k) - begin[k]));
    const tangent = (phase) => q.map((_, k) => -swings[k] * Math.sin(phase + LAGGING * k));
    return { at, tangent };
  }

  /**
   * Return the work [J] that both laws have put out up to every point of a lap, LAP_POINTS + 1 numbers each, from their
   * wrenches. The sum over equal steps is exact to rounding for the whole lap, since the integrand is periodic and smooth;
   * the usual law's jumps where one hand is a half turn from rest, seen from the other.
   */
  works(lap, grasps) {
    const spring = this.spring(grasps), step = (2 * Math.PI) / LAP_POINTS, { n, base } = this;
    const powers = Array.from({ length: LAP_POINTS + 1 }, (_, k) => {
      const phase = (k % LAP_POINTS) * step, q = lap.at(phase), dq = new Float64Array(n);
      dq.set(lap.tangent(phase), base);
      const twists = this.both.flatMap((hand) => Array.from(multiply(hand.jacobian(q), dq, 6, n, 1)));
      const wrenches = { conventional: this.usual(q, spring), exact: this.call("pair_wrench", { q, ...spring }) };
      return Object.fromEntries(PAIR_LAWS.map((law) => [law, -dot(wrenches[law], twists)]));
    });
    return Object.fromEntries(PAIR_LAWS.map((law) => {
      const work = new Float64Array(LAP_POINTS + 1);
      for (let k = 0; k < LAP_POINTS; ++k) work[k + 1] = work[k] + (step * (powers[k][law] + powers[k + 1][law])) / 2;
      return [law, work];
    }));
  }
}
