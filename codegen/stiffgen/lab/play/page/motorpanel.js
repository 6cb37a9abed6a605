// SPDX-License-Identifier: MIT
// The panel of the motors of closed loops: torques and stiffness, and where the passive joints are.

import { number } from "./figures.js";
import { DEGREES } from "./values.js";

/** Return a cell of a table with a text. */
function cellOf(text, tag = "td") {
  return Object.assign(document.createElement(tag), { textContent: text });
}

/** Return the line of one motor: name, torque, its row of the stiffness, and that row without the load's terms. */
function motorLine({ name, prismatic }, k, { a, torque, stiffness, without }, first) {
  const row = (matrix) => Array.from(matrix.slice(a * (first + k) + first, a * (first + k + 1)), (x) => number(x)).join(", ");
  const line = document.createElement("tr"), title = cellOf(name, "th"), per = prismatic ? "N/m" : "N m/rad";
  title.scope = "row";
  const cells = [`${number(torque[first + k])} ${prismatic ? "N" : "N m"}`, `${row(stiffness)} ${per}`, `${row(without)} ${per}`];
  line.append(title, ...cells.map((text) => cellOf(text)));
  return line;
}

/** Show the motors, and the passive joints that follow them. */
export function showMotors({ $, robot, state, now }) {
  const { actuated } = robot.loops;
  const lines = actuated.map((joint, k) => motorLine(robot.coordinates[joint], k, now.motors, state.tip.base));
  $("motors").replaceChildren(...lines);
  const passive = robot.coordinates.flatMap(({ name, prismatic }, k) => {
    const place = prismatic ? `${number(state.q[k] * 1000)} mm` : `${number(state.q[k] * DEGREES)} deg`;
    return actuated.includes(k) ? [] : [`${name} ${place}`];
  });
  $("passive").textContent = passive.length ? `Passive joints follow: ${passive.join(", ")}.` : "";
}

/** Return q with joint k at a value; passive joints of closed loops follow, or q stays where no loop closes. */
export function withJoint({ $, robot, state }, k, value) {
  const q = state.tip.movedTo(state.q, state.q.map((other, i) => (i === k ? value : other)));
  const isStuck = robot.loops && q === state.q;
  $("closed").textContent = isStuck ? `The loops do not close with ${robot.coordinates[k].name} there; the joints stay.` : "";
  return q;
}
