// SPDX-License-Identifier: MIT
// The page's state, and the values computed from it.

import { blockOf, multiply, plus, transpose } from "./algebra.js";
import { reach } from "./chain.js";
import { PUSH, softGains, softness } from "./compliance.js";
import { closedLoop, loopWork, originOf, rotationOf, stiffnesses } from "./mechanics.js";

export const GAINS = [700, 700, 800, 30, 30, 30], WRENCH = [5, -10, 15, 4, -3, 8], MOMENT = [0, 0, 0, 4, -3, 8];
export const DEGREES = 180 / Math.PI;

/** Return the state at the start: tip, configuration, wrench [N, N m], gains, loop, place on the loop and ellipsoids. */
export function startState(tip, home) {
  const n = home.length;
  return {
    tip, q: home, jointGains: softGains(tip.robot), wrench: Float64Array.from(WRENCH), gains: GAINS.slice(), chosen: false,
    loop: { kind: n < 6 ? "joints" : "turn", axes: [0, 1], joints: [0, Math.min(1, n - 1)], radius: 0.1, reversed: false },
    lap: 0, going: false, cursor: null, show: { translation: true, rotation: true, compliance: false },
  };
}

/** Return the values of a state: matrices, softness, and of a tree its loop with the laws' works, else the motors'. */
export function valuesOf(robot, state) {
  const begun = performance.now(), { tip, q, wrench, gains } = state;
  const matrices = stiffnesses(tip, q, wrench, gains, state.chosen);
  const values = robot.loops
    ? { motors: tip.motors(q, wrench, matrices.K), path: null, marker: () => null, works: {} }
    : valuesOnLoop(robot, state, matrices);
  const soft = softness(tip, q, wrench, state.jointGains);
  return { matrices, soft, ...values, time: performance.now() - begun };
}

/** Return the loop, the works of the laws on it, and its path: of the tip, or of a point beside a tip that only turns. */
function valuesOnLoop(robot, state, matrices) {
  const { tip, q, wrench } = state, loop = closedLoop(tip, q, state.loop);
  const works = loopWork(tip, q, wrench, matrices, loop);
  const pose = tip.pose(q), arm = [0, 0, 0];
  if (state.loop.kind === "turn") arm[3 - state.loop.axes[0] - state.loop.axes[1]] = 0.4 * reach(robot);
  const beside = multiply(transpose(rotationOf(pose), 3, 3), arm, 3, 3, 1);
  const marker = (phase) => {
    const there = tip.pose(loop.at(phase));
    return plus(originOf(there), multiply(rotationOf(there), beside, 3, 3, 1));
  };
  const path = Array.from({ length: 48 }, (_, k) => marker((2 * Math.PI * k) / 48));
  return { loop, works, marker, path };
}

/**
 * Return the ellipsoids to draw: {name, block (3 x 3), length}: an axis is as long as its eigenvalue times length [m].
 * Those of the spring's stiffness grow with the arm; those of the compliance are where PUSH would move the tip.
 */
export function ellipsoidsOf(robot, show, K, { usual, loaded }) {
  const size = reach(robot), made = [];
  if (show.rotation) made.push({ name: "rotation", block: blockOf(K, 3), length: 0.0035 * size });
  if (show.translation) made.push({ name: "translation", block: blockOf(K, 0), length: 0.00025 * size });
  if (!show.compliance) return made;
  made.push({ name: "conventional", block: usual, length: PUSH });
  if (loaded) made.push({ name: "exact", block: loaded, length: PUSH });
  return made;
}
