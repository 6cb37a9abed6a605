// SPDX-License-Identifier: MIT
// Frames of the joints, for drawing and for dragging a link. The kernels compute the tip's pose and Jacobian.

import { cross, multiply, norm, plus, turn } from "./algebra.js";

/** Transform a point from a frame to the base [m]. */
export const placed = (frame, point) => plus(frame.origin, multiply(frame.rotation, point, 3, 3, 1));

/** Return the frames {rotation (9), origin (3), axis (3), value} of all joints at q; base axes, m, rad. */
export function jointFrames(robot, q) {
  const frames = [];
  for (const joint of robot.joints) {
    const before = joint.parent < 0 ? { rotation: turn([0, 0, 0]), origin: [0, 0, 0] } : frames[joint.parent];
    const value = joint.coordinate < 0 ? 0 : joint.multiplier * q[joint.coordinate] + joint.offset;
    let rotation = multiply(before.rotation, joint.rotation.flat(), 3, 3, 3);
    let origin = Array.from(placed(before, joint.translation));
    const axis = Array.from(multiply(rotation, joint.axis, 3, 3, 1));
    if (joint.prismatic) origin = plus(origin, axis, value);
    else rotation = multiply(rotation, turn(joint.axis.map((x) => x * value)), 3, 3, 3);
    frames.push({ rotation, origin, axis, value });
  }
  return frames;
}

/** Return the two ends of each closed loop, in base axes [m]; [x, y, z] each. */
export function loopEnds(robot, frames) {
  const at = ({ joint, point }) => (joint < 0 ? point : Array.from(placed(frames[joint], point)));
  return robot.loops ? robot.loops.ends.map((pair) => pair.map(at)) : [];
}

/** Return the tip's frame {rotation, origin}; the pose of a tool at run time, [R p; 0 1] (16), is applied last. */
export function tipFrame(robot, tip, frames, tool = null) {
  const joint = frames[tip.joint];
  let rotation = multiply(joint.rotation, tip.rotation.flat(), 3, 3, 3);
  let origin = Array.from(placed(joint, tip.translation));
  if (tool) {
    origin = Array.from(placed({ rotation, origin }, [tool[3], tool[7], tool[11]]));
    rotation = multiply(rotation, [0, 1, 2].flatMap((i) => [0, 1, 2].map((j) => tool[4 * i + j])), 3, 3, 3);
  }
  return { rotation, origin };
}

/** Return the Jacobian (3 x coordinates) of the velocity of a point that moves with a joint. */
export function pointJacobian(robot, frames, joint, point) {
  const n = robot.coordinates.length, J = new Float64Array(3 * n);
  for (let k = joint; k >= 0; k = robot.joints[k].parent) {
    const { coordinate, multiplier, prismatic } = robot.joints[k];
    if (coordinate < 0) continue;
    const rate = prismatic ? frames[k].axis : cross(frames[k].axis, plus(point, frames[k].origin, -1));
    for (let i = 0; i < 3; ++i) J[i * n + coordinate] += multiplier * rate[i];
  }
  return J;
}

/** Return a lower bound of the arm's reach [m]: the length of its parts, and half the range of sliding joints. */
export function reach(robot) {
  let most = 0;
  const lengths = [];
  robot.joints.forEach((joint, k) => {
    const limits = robot.coordinates[joint.coordinate];
    const slide = joint.prismatic && limits && limits.upper !== null && limits.lower !== null;
    const before = joint.parent < 0 ? 0 : lengths[joint.parent];
    lengths[k] = before + norm(joint.translation) + (slide ? (limits.upper - limits.lower) / 2 : 0);
    most = Math.max(most, lengths[k]);
  });
  for (const tip of robot.tips) most = Math.max(most, lengths[tip.joint] + norm(tip.translation));
  return most || 1;
}

/** Return the range of a coordinate; a side without a limit lies at least `far` [rad or m] from zero and from the limit. */
export const rangeOf = ({ lower, upper }, far) => [
  lower ?? Math.min(-far, (upper ?? 0) - far), upper ?? Math.max(far, (lower ?? 0) + far),
];

/** Clamp the joints to their limits. */
export const within = (robot, q) =>
  q.map((value, k) => {
    const { lower, upper } = robot.coordinates[k];
    return Math.min(Math.max(value, lower ?? -Infinity), upper ?? Infinity);
  });
