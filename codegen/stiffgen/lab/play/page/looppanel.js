// SPDX-License-Identifier: MIT
// The panel of the loop: its kind and radius, the way round it, and the work of each law.

import { largest } from "./algebra.js";
import { LAPS, drawWork, number, workAt } from "./figures.js";
import { LAWS } from "./mechanics.js";
import { options, slider } from "./panels.js";

const LAW_TEXTS = {
  conventional: "−<i>K<sub>u</sub></i> Δ<i>q</i>, with the conventional <i>K<sub>u</sub></i> at <i>q</i>, held",
  corrected: "−<i>K<sub>q</sub></i> Δ<i>q</i>, with the corrected <i>K<sub>q</sub></i> at <i>q</i>, held",
  secant: "−<i>K<sub>q</sub></i> Δ<i>q</i>, with <i>K<sub>q</sub></i> of each posture and <i>F</i> held",
  exact: "−∂<i>U</i>/∂<i>q</i> of the spring, less its load at <i>q</i>",
};
const LOOPS = [
  ["turn", [0, 1], "turn the tip about x and y"], ["turn", [1, 2], "turn the tip about y and z"], ["turn", [2, 0], "turn the tip about z and x"],
  ["carry", [0, 1], "carry the tip along x and y"], ["carry", [1, 2], "carry the tip along y and z"], ["carry", [2, 0], "carry the tip along z and x"],
  ["joints", [], "two joints"],
];

/** Write a line of the table for each law. */
function writeLaws($) {
  for (const law of LAWS) {
    const row = document.createElement("tr");
    row.innerHTML = `<th scope="row"><span class="key ${law}">${law}</span></th><td>${LAW_TEXTS[law]}</td><td id="law-${law}"></td>`;
    $("laws").append(row);
  }
}

/** Return the word on the button that starts and stops the way round. */
function wordOfGo({ state, calm }) {
  if (state.going) return "Stop";
  if (calm.matches) return "An eighth of a lap on";
  return state.lap >= LAPS ? "Go round again" : "Go round";
}

/** Return what the load does to the conventional matrix and to the work of a lap. */
function effectOf({ matrices, works, loop }, metres, joules) {
  const apart = 2 * largest(matrices.antisymmetric), most = largest(matrices.conventional);
  if (apart <= 1e-9 * most) return "No moment acts: the conventional matrix, too, is symmetric, and no law makes energy in a lap.";
  const radius = metres ? `${number(1000 * loop.radius)} mm` : `${number(loop.radius)} rad`;
  const made = works.conventional?.at(-1) ?? 0, energy = joules(Math.abs(made));
  const lap = made > 0 ? `makes ${energy} out of nothing, and takes as much in reverse` : `takes ${energy}, and makes as much out of nothing in reverse`;
  return `Under this push, mirrored entries of the conventional matrix differ by up to ${number(apart)} N m/rad: ` +
    `a lap of the loop, radius ${radius}, ${lap}. Corrected: 0 N m/rad, 0 J.`;
}

/** The panel of a page. */
export class LoopPanel {
  constructor(page) {
    this.page = page;
    const { $, state, robot } = page;
    writeLaws($);
    options($("loop"), LOOPS.map(([, , text], k) => [k, text]));
    for (const id of ["first", "second"]) options($(id), robot.coordinates.map(({ name }, k) => [k, name]));
    $("loop").value = LOOPS.findIndex(([kind]) => kind === state.loop.kind);
    $("second").value = state.loop.joints[1];
    for (const id of ["loop", "first", "second"]) $(id).addEventListener("change", () => this.choose());
    $("go").addEventListener("click", () => this.go());
    $("reverse").addEventListener("click", () => {
      this.setLap(0);
      page.update({ loop: { ...state.loop, reversed: !state.loop.reversed } });
    });
    this.fill();
  }

  /** Show the work of each law so far. */
  show() {
    const { $, state, now, colours } = this.page, { works, loop } = now;
    drawWork($("work"), works, state.lap, colours);
    const most = Math.max(...LAWS.map((law) => (works[law] ? largest(works[law]) : 0)));
    const joules = (value) => (Math.abs(value) <= 1e-12 * Math.max(1, most) ? "0 J" : `${number(value)} J`);
    for (const law of LAWS) $(`law-${law}`).textContent = works[law] ? joules(works[law].at(-1)) : "–";
    const done = ["conventional", "exact"].filter((law) => works[law]).map((law) => `${law} ${joules(workAt(works[law], state.lap))}`);
    $("effect").textContent = effectOf(now, this.metres, joules);
    const smaller = loop.radius < state.loop.radius * (1 - 1e-9) ? ` The radius is clamped to ${number(loop.radius)}: near a singular posture a short way of the tip needs a long one of the joints.` : "";
    $("lap").textContent = `${state.lap.toFixed(2)} laps, put out so far: ${done.join(", ")}.${smaller}`;
    $("go").textContent = wordOfGo(this.page);
    $("reverse").setAttribute("aria-pressed", state.loop.reversed);
  }

  /** Stop at a place on the loop [laps]. */
  setLap(lap) {
    const { page } = this, { state } = page;
    page.swing.stop();
    [state.lap, state.going] = [Math.min(LAPS, Math.max(0, lap)), false];
    this.place(state.lap);
    page.redraw();
  }

  /** Move the slider of the place. */
  place(lap) {
    this.places.set(lap);
  }

  /** Whether the loop's radius is a length. */
  get metres() {
    const { kind, joints } = this.page.state.loop;
    return kind === "carry" || (kind === "joints" && this.page.robot.coordinates[joints[0]].prismatic);
  }

  /** Make the sliders of the radius and of the place anew, in the units of the loop's kind. */
  fill() {
    const { page } = this, { $, state } = page, { kind, radius } = state.loop;
    const [min, max, step, unit, scale] = this.metres ? [5, 300, 5, "mm", 1000] : [0.01, 0.5, 0.01, "rad", 1];
    $("loop-sliders").replaceChildren();
    slider($("loop-sliders"), {
      label: "radius of the loop", shown: "radius", unit, min, max, step,
      value: radius * scale, changed: (value) => page.update({ loop: { ...state.loop, radius: value / scale } }),
    });
    this.places = slider($("loop-sliders"), {
      label: "place on the loop", shown: "place", unit: "laps", min: 0, max: LAPS, step: 0.01, value: state.lap,
      changed: (lap) => this.setLap(lap),
    });
    for (const pair of document.querySelectorAll(".pair")) pair.hidden = kind !== "joints";
  }

  choose() {
    const { page } = this, { $, state } = page, [kind, axes] = LOOPS[$("loop").value];
    page.update({ loop: { ...state.loop, kind, axes, joints: [Number($("first").value), Number($("second").value)] } });
    this.fill();
  }

  /** Start or stop the way round; without motion, go an eighth of a lap on. */
  go() {
    const { page } = this, { state } = page;
    if (page.calm.matches) {
      this.setLap(state.lap >= LAPS ? 0 : Math.min(LAPS, state.lap + 0.125));
      return;
    }
    if (!state.going && state.lap >= LAPS) state.lap = 0;
    state.going = !state.going;
    page.redraw();
  }
}
