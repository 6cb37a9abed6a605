// SPDX-License-Identifier: MIT
// The panel of the matrices: four pictures, the entry under the pointer, and the ellipsoids' axes.

import { blockOf, eigen, largest, plus } from "./algebra.js";
import { cellAt, drawMatrix, number, scales, shade } from "./figures.js";

const MATRICES = [
  ["conventional", "conventional <i>K<sub>u</sub></i>"],
  ["corrected", "corrected <i>K<sub>q</sub></i>"],
  ["exact", "exact ∂²<i>U</i>/∂<i>q</i>∂<i>q</i>"],
  ["antisymmetric", "antisymmetric part of <i>K<sub>u</sub></i>"],
];
const WAYS = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };

/** Return a number as text: 0 and rounding beside a scale are shown by their power of ten. */
function tiny(value, beside) {
  if (value > 1e-9 * beside) return number(value);
  return value === 0 ? "0" : value.toExponential(0).replace("-", "−");
}

/** Return the rows and columns of the matrices: name, label on the picture, and whether it is a translation. */
function rowsOf(robot) {
  const base = robot.floating ? ["x", "y", "z", "about x", "about y", "about z"] : [];
  return [
    ...base.map((way, k) => ({ name: `base ${way}`, label: { text: "xyzabc"[k], colour: "#888888" }, sliding: k < 3 })),
    ...robot.coordinates.map(({ name, prismatic }, k) => ({ name, label: { text: k + 1, colour: shade(k) }, sliding: prismatic })),
  ];
}

/** Return the unit of the entry of two rows. */
function unitOf(row, column) {
  return `${row.sliding ? "N" : "N m"}/${column.sliding ? "m" : "rad"}`;
}

/** Make the canvas of one matrix, whose cells the pointer and the arrow keys read. */
function matrixCanvas(page, title, pointAt) {
  const { state } = page, figure = document.createElement("figure");
  figure.innerHTML = `<figcaption>${title}<output></output></figcaption><canvas tabindex="0" role="img"></canvas>`;
  const canvas = figure.querySelector("canvas");
  const point = (event) => pointAt(cellAt(canvas, event.offsetX, event.offsetY, state.tip.n));
  canvas.addEventListener("pointermove", point);
  canvas.addEventListener("pointerdown", point);
  canvas.addEventListener("pointerleave", () => document.activeElement !== canvas && pointAt(null));
  canvas.addEventListener("focus", () => canvas.matches(":focus-visible") && pointAt(state.cursor ?? [0, 0]));
  canvas.addEventListener("blur", () => pointAt(null));
  canvas.addEventListener("keydown", (event) => {
    const way = WAYS[event.key];
    if (!way) return;
    event.preventDefault();
    pointAt(plus(state.cursor ?? [0, 0], way).map((k) => Math.min(Math.max(k, 0), state.tip.n - 1)));
  });
  page.$("maps").append(figure);
  return { canvas, output: figure.querySelector("output") };
}

/** Wire the panel. Gives {showMatrices(), showEllipsoids()}. */
export function matrixPanel(page) {
  const { $, state, robot } = page, rows = rowsOf(robot);
  const pointAt = (cell) => {
    state.cursor = cell;
    showMatrices();
  };
  const maps = Object.fromEntries(
    MATRICES.map(([name, title]) => [name, matrixCanvas(page, `<b class="key ${name}">${title}</b>`, pointAt)]),
  );

  function textOfMap(name, matrix, most) {
    if (!matrix) return "";
    if (!state.cursor) return name === "antisymmetric" ? `largest ${tiny(largest(matrix), most)}` : "";
    const [i, j] = state.cursor;
    return `${rows[i].name}, ${rows[j].name}: ${number(matrix[i * state.tip.n + j], 4)} ${unitOf(rows[i], rows[j])}`;
  }

  function showMatrices() {
    if (!page.now.matrices) return;
    const { matrices } = page.now, { most, antisymmetric } = scales(matrices), { cursor } = state, n = state.tip.n;
    const labels = rows.map(({ label }) => label);
    for (const [name] of MATRICES) {
      const { canvas, output } = maps[name], matrix = matrices[name];
      drawMatrix(canvas, matrix, { n, most: name === "antisymmetric" ? antisymmetric : most, colours: page.colours, cursor, labels });
      output.textContent = textOfMap(name, matrix, most);
      const read = matrix ? `${n} by ${n} entries, the largest ${number(largest(matrix))}${cursor ? `; ${output.textContent}` : ""}` : "none";
      canvas.setAttribute("aria-label", `${name}: ${read}. Arrow keys read single entries.`);
    }
    $("scale").textContent = `Black or white: positive, red: negative; shades grow with the square root of the value, up to ${number(most)} N m/rad for the three stiffnesses and ${number(antisymmetric)} for the antisymmetric part. Rows and columns in the order of the joints.`;
    $("verdict").textContent = verdict(matrices, most);
  }

  function showEllipsoids() {
    const lines = [["translation", 0, "N/m"], ["rotation", 3, "N m/rad"]].map(([name, first, unit]) => {
      const axes = eigen(blockOf(page.now.matrices.K, first), 3).values.sort((a, b) => b - a).map((v) => number(v)).join(", ");
      return `<dt class="key ${name}">${name}</dt><dd>${axes} ${unit} along its axes</dd>`;
    });
    $("ellipsoids").innerHTML = lines.join("");
    const { spring } = page.now.matrices, energy = spring && state.tip.spring("energy", state.q, spring)[0];
    $("energy").textContent = spring ? `The spring that bears this wrench here stores ${number(energy)} J.` : "No spring with these gains bears this wrench.";
  }

  return { showMatrices, showEllipsoids };
}

/** Return how the conventional and the corrected stiffness differ from symmetry and from the exact one. */
function verdict(matrices, most) {
  const asymmetric = largest(matrices.antisymmetric);
  const conventional = asymmetric > 1e-9 * most ? `asymmetric by ${number(asymmetric)} N m/rad` : "symmetric, as no moment acts";
  const begin = `Conventional: ${conventional}. Corrected: symmetric to the last bit. `;
  if (!matrices.exact) {
    return `${begin}No spring with these gains can hold this wrench: a spring that softens holds only so much moment. Choose larger gains or a smaller moment.`;
  }
  const apart = largest(plus(matrices.corrected, matrices.exact, -1));
  const why = apart > 1e-9 * most ? ", since gains as they are leave out that the loaded spring has another stiffness" : ", rounding";
  return `${begin}Corrected less exact: ${tiny(apart, most)} N m/rad${why}.`;
}
