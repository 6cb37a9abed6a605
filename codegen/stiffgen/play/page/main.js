// SPDX-License-Identifier: MIT
// The page: its state, the values computed from the state, and the drawing.

import { eigen, largest, multiply, plus, transpose } from "./algebra.js";
import { loopEnds, jointFrames, reach } from "./chain.js";
import { LAPS, cellAt, drawMatrix, drawWork, number, scales, shade, theme, workAt } from "./figures.js";
import { startKernels } from "./kernels.js";
import {
  LAWS, Tip, bentPosture, closedLoop, loopWork, nearSingular, originOf, rotationOf, stiffnesses,
} from "./mechanics.js";
import { options, slider } from "./panels.js";
import { swingPanel } from "./swingpanel.js";
import { View } from "./view.js";

const SECONDS = 4; // a lap takes
const GAINS = [700, 700, 800, 30, 30, 30], WRENCH = [5, -10, 15, 4, -3, 8], MOMENT = [0, 0, 0, 4, -3, 8];
const MATRICES = [
  ["conventional", "conventional <i>K<sub>u</sub></i>"],
  ["corrected", "corrected <i>K<sub>q</sub></i>"],
  ["exact", "exact ∂²<i>U</i>/∂<i>q</i>∂<i>q</i>"],
  ["antisymmetric", "antisymmetric part of <i>K<sub>u</sub></i>"],
];
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
const $ = (id) => document.getElementById(id);
const calm = window.matchMedia("(prefers-reduced-motion: reduce)");

function fail(text) {
  $("failure").textContent = text;
  $("failure").hidden = false;
}

async function start() {
  const robot = JSON.parse($("data").textContent);
  const bytes = Uint8Array.from(atob($("wasm").textContent), (letter) => letter.charCodeAt(0));
  const kernels = await startKernels(bytes, robot.functions, `${robot.name}_self_check`);
  const tips = robot.tips.map((_, k) => new Tip(robot, k, kernels)), n = robot.coordinates.length;
  const known = robot.loops?.start ?? robot.paper;
  let home = known ? Float64Array.from(known) : bentPosture(robot);
  if (robot.loops) home = tips[0].movedTo(home, home); // closed to the last digit
  for (const each of document.querySelectorAll(".of-tree")) each.hidden = Boolean(robot.loops);
  $("motors-panel").hidden = !robot.loops;

  const state = {
    tip: tips[0], q: home, wrench: Float64Array.from(WRENCH), gains: GAINS.slice(), chosen: false,
    loop: { kind: n < 6 ? "joints" : "turn", axes: [0, 1], joints: [0, Math.min(1, n - 1)], radius: 0.1, reversed: false },
    lap: 0, going: false, cursor: null, show: { translation: true, rotation: true },
  };
  let now = {}, waiting = { compute: true, frame: false }, colours = theme(), view = null;

  // Values computed from the state. All calls of kernels are here.
  function compute() {
    const begun = performance.now(), { tip, q, wrench, gains } = state;
    const matrices = stiffnesses(tip, q, wrench, gains, state.chosen);
    if (robot.loops) {
      now = { matrices, motors: tip.motors(q, wrench, matrices.K), path: null, marker: () => null, works: {}, time: performance.now() - begun };
      return;
    }
    const loop = closedLoop(tip, q, state.loop);
    const works = loopWork(tip, q, wrench, matrices, loop);
    // The loop is drawn through the tip, or through a point beside the tip where the tip only turns.
    const pose = tip.pose(q), arm = [0, 0, 0];
    if (state.loop.kind === "turn") arm[3 - state.loop.axes[0] - state.loop.axes[1]] = 0.4 * reach(robot);
    const beside = multiply(transpose(rotationOf(pose), 3, 3), arm, 3, 3, 1);
    const marker = (phase) => {
      const there = tip.pose(loop.at(phase));
      return plus(originOf(there), multiply(rotationOf(there), beside, 3, 3, 1));
    };
    const path = Array.from({ length: 48 }, (_, k) => marker((2 * Math.PI * k) / 48));
    now = { matrices, loop, works, marker, path, time: performance.now() - begun };
  }

  function update(change = {}) {
    Object.assign(state, change);
    if (Object.keys(change).length) swing.stop(); // not where only the window changed
    waiting.compute = true;
    redraw();
  }

  function redraw() {
    if (waiting.frame) return;
    waiting.frame = true;
    requestAnimationFrame(frame);
  }

  let last = null;
  function frame(time) {
    waiting.frame = false;
    if (state.going) {
      state.lap += (last === null ? 0 : Math.min(100, time - last)) / 1000 / SECONDS;
      if (state.lap >= LAPS) [state.lap, state.going] = [LAPS, false];
      sliders.lap.set(state.lap);
    }
    if (swing.going) swing.advance(last === null ? 0 : Math.min(33, time - last) / 1000);
    last = state.going || swing.going ? time : null;
    if (waiting.compute) {
      compute();
      if (robot.loops) showMotors();
      else showMatrices();
      showEllipsoids();
    }
    waiting.compute = false;
    view?.draw();
    if (!robot.loops) showLoop();
    $("timing").textContent = `Kernels of this picture: ${now.time.toFixed(1)} ms.`;
    swing.show(colours);
    markPresets();
    if (!performance.getEntriesByName("first picture").length) performance.mark("first picture");
    if (state.going || swing.going) redraw();
  }
  const swing = swingPanel({ $, state, now: () => now, redraw, calm });

  // ---- matrices
  const maps = Object.fromEntries(
    MATRICES.map(([name, title]) => {
      const figure = document.createElement("figure");
      figure.innerHTML = `<figcaption><b class="key ${name}">${title}</b><output></output></figcaption><canvas tabindex="0" role="img"></canvas>`;
      const canvas = figure.querySelector("canvas");
      const point = (event) => pointAt(cellAt(canvas, event.offsetX, event.offsetY, state.tip.n));
      canvas.addEventListener("pointermove", point);
      canvas.addEventListener("pointerdown", point);
      canvas.addEventListener("pointerleave", () => document.activeElement !== canvas && pointAt(null));
      canvas.addEventListener("focus", () => canvas.matches(":focus-visible") && pointAt(state.cursor ?? [0, 0]));
      canvas.addEventListener("blur", () => pointAt(null));
      canvas.addEventListener("keydown", (event) => {
        const way = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] }[event.key];
        if (!way) return;
        event.preventDefault();
        pointAt(plus(state.cursor ?? [0, 0], way).map((k) => Math.min(Math.max(k, 0), state.tip.n - 1)));
      });
      $("maps").append(figure);
      return [name, { canvas, output: figure.querySelector("output") }];
    }),
  );
  const baseNames = robot.floating ? ["x", "y", "z", "about x", "about y", "about z"].map((way) => `base ${way}`) : [];
  const names = [...baseNames, ...robot.coordinates.map(({ name }) => name)];
  const labels = names.map((_, k) => ({ text: k < baseNames.length ? "xyzabc"[k] : k - baseNames.length + 1, colour: k < baseNames.length ? "#888888" : shade(k - baseNames.length) }));
  const unitOf = (i, j) => {
    const sliding = [i, j].map((k) => (robot.floating && k < 3) || (k >= baseNames.length && robot.coordinates[k - baseNames.length].prismatic));
    return sliding[0] ? (sliding[1] ? "N/m" : "N/rad") : sliding[1] ? "N m/m" : "N m/rad";
  };

  function pointAt(cell) {
    state.cursor = cell;
    showMatrices();
  }

  function showMatrices() {
    if (!now.matrices) return;
    const { matrices } = now, { most, antisymmetric } = scales(matrices), size = state.tip.n, { cursor } = state;
    for (const [name] of MATRICES) {
      const { canvas, output } = maps[name], matrix = matrices[name];
      drawMatrix(canvas, matrix, { n: size, most: name === "antisymmetric" ? antisymmetric : most, colours, cursor, labels });
      const [i, j] = cursor ?? [];
      output.textContent = !matrix ? "" : cursor ? `${names[i]}, ${names[j]}: ${number(matrix[i * size + j], 4)} ${unitOf(i, j)}` : name === "antisymmetric" ? `largest ${tiny(largest(matrix), most)}` : "";
      canvas.setAttribute("aria-label", `${name}: ${matrix ? `${size} by ${size} entries, the largest ${number(largest(matrix))}${cursor ? `; ${output.textContent}` : ""}` : "none"}. Arrow keys read single entries.`);
    }
    $("scale").textContent = `Black or white: positive, red: negative; shades grow with the square root of the value, up to ${number(most)} N m/rad for the three stiffnesses and ${number(antisymmetric)} for the antisymmetric part. Rows and columns in the order of the joints.`;
    const apart = matrices.exact && largest(plus(matrices.corrected, matrices.exact, -1));
    const asymmetric = largest(matrices.antisymmetric);
    $("verdict").textContent =
      `Conventional: ${asymmetric > 1e-9 * most ? `asymmetric by ${number(asymmetric)} N m/rad` : "symmetric, as no moment acts"}. Corrected: symmetric to the last bit. ` +
      (matrices.exact
        ? `Corrected less exact: ${tiny(apart, most)} N m/rad${apart > 1e-9 * most ? ", since gains as they are leave out that the loaded spring has another stiffness" : ", rounding"}.`
        : "No spring with these gains can hold this wrench: a spring that softens holds only so much moment. Choose larger gains or a smaller moment.");
  }
  const tiny = (value, beside) => (value <= 1e-9 * beside ? (value === 0 ? "0" : value.toExponential(0).replace("-", "−")) : number(value));

  function showEllipsoids() {
    const rows = [["translation", 0, "N/m"], ["rotation", 3, "N m/rad"]].map(([name, first, unit]) => {
      const block = Float64Array.from({ length: 9 }, (_, k) => now.matrices.K[6 * (first + Math.floor(k / 3)) + first + (k % 3)]);
      return `<dt class="key ${name}">${name}</dt><dd>${eigen(block, 3).values.sort((a, b) => b - a).map((v) => number(v)).join(", ")} ${unit} along its axes</dd>`;
    });
    $("ellipsoids").innerHTML = rows.join("");
    const { spring } = now.matrices, energy = spring && state.tip.spring("energy", state.q, spring)[0];
    $("energy").textContent = spring ? `The spring that bears this wrench here stores ${number(energy)} J.` : "No spring with these gains bears this wrench.";
  }

  // ---- the motors of closed loops
  function showMotors() {
    const { a, torque, stiffness, without } = now.motors, first = state.tip.base;
    const cell = (text) => Object.assign(document.createElement("td"), { textContent: text });
    const row = (matrix, k) => Array.from(matrix.slice(a * (first + k) + first, a * (first + k + 1)), (x) => number(x)).join(", ");
    $("motors").replaceChildren(...robot.loops.actuated.map((joint, k) => {
      const line = document.createElement("tr"), { name, prismatic } = robot.coordinates[joint];
      const title = Object.assign(document.createElement("th"), { scope: "row", textContent: name });
      const per = prismatic ? "N/m" : "N m/rad";
      line.append(title, cell(`${number(torque[first + k])} ${prismatic ? "N" : "N m"}`), cell(`${row(stiffness, k)} ${per}`), cell(`${row(without, k)} ${per}`));
      return line;
    }));
    const passive = robot.coordinates.flatMap(({ name, prismatic }, k) =>
      robot.loops.actuated.includes(k) ? [] : [`${name} ${prismatic ? `${number(state.q[k] * 1000)} mm` : `${number(state.q[k] * degrees)} deg`}`]);
    $("passive").textContent = passive.length ? `Passive joints follow: ${passive.join(", ")}.` : "";
  }

  /** Return q with joint k at a value; passive joints of closed loops follow, or q stays where no loop closes. */
  function withJoint(k, value) {
    const q = state.tip.movedTo(state.q, state.q.map((other, i) => (i === k ? value : other)));
    const isStuck = robot.loops && q === state.q;
    $("closed").textContent = isStuck ? `The loops do not close with ${robot.coordinates[k].name} there; the joints stay.` : "";
    return q;
  }

  // ---- the loop
  for (const law of LAWS) {
    const row = document.createElement("tr");
    row.innerHTML = `<th scope="row"><span class="key ${law}">${law}</span></th><td>${LAW_TEXTS[law]}</td><td id="law-${law}"></td>`;
    $("laws").append(row);
  }

  function showLoop() {
    const { works } = now;
    drawWork($("work"), works, state.lap, colours);
    const most = Math.max(...LAWS.map((law) => (works[law] ? largest(works[law]) : 0)));
    const joules = (value) => (Math.abs(value) <= 1e-12 * Math.max(1, most) ? "0 J" : `${number(value)} J`);
    for (const law of LAWS) $(`law-${law}`).textContent = works[law] ? joules(works[law].at(-1)) : "–";
    const done = ["conventional", "exact"].filter((law) => works[law]).map((law) => `${law} ${joules(workAt(works[law], state.lap))}`);
    const smaller = now.loop.radius < state.loop.radius * (1 - 1e-9) ? ` The radius is clamped to ${number(now.loop.radius)}: near a singular posture a short way of the tip needs a long one of the joints.` : "";
    $("lap").textContent = `${state.lap.toFixed(2)} laps, put out so far: ${done.join(", ")}.${smaller}`;
    $("go").textContent = state.going ? "Stop" : calm.matches ? "An eighth of a lap on" : state.lap >= LAPS ? "Go round again" : "Go round";
    $("reverse").setAttribute("aria-pressed", state.loop.reversed);
  }

  $("go").addEventListener("click", () => {
    if (calm.matches) {
      setLap(state.lap >= LAPS ? 0 : Math.min(LAPS, state.lap + 0.125));
      return;
    }
    if (!state.going && state.lap >= LAPS) state.lap = 0;
    state.going = !state.going;
    redraw();
  });
  $("reverse").addEventListener("click", () => {
    setLap(0);
    update({ loop: { ...state.loop, reversed: !state.loop.reversed } });
  });
  function setLap(lap) {
    swing.stop();
    [state.lap, state.going] = [Math.min(LAPS, Math.max(0, lap)), false];
    sliders.lap.set(state.lap);
    redraw();
  }

  // ---- controls
  const sliders = { joints: [], wrench: [], gains: [] };
  const degrees = 180 / Math.PI;
  robot.coordinates.forEach(({ name, prismatic, lower, upper }, k) => {
    if (robot.loops && !robot.loops.actuated.includes(k)) return;
    const scale = prismatic ? 1000 : degrees, ends = [lower ?? (prismatic ? -1 : -Math.PI), upper ?? (prismatic ? 1 : Math.PI)];
    const text = document.createElement("i");
    text.textContent = name;
    sliders.joints.push({
      k,
      ...slider($("joints"), {
        label: `joint ${k + 1}, ${name}`, shown: text.innerHTML, unit: prismatic ? "mm" : "deg", min: ends[0] * scale, max: ends[1] * scale, step: 0.1,
        value: state.q[k] * scale, colour: shade(k), limited: true,
        changed: (value) => posture(withJoint(k, value / scale), k),
      }),
      scale,
    });
  });
  ["x", "y", "z", "x", "y", "z"].forEach((axis, k) => {
    const force = k < 3, symbol = force ? "f" : "m", common = { step: force ? 1 : 0.1, unit: force ? "N" : "N m" };
    sliders.wrench.push(slider($("wrench"), {
      label: `${force ? "force" : "moment"} along ${axis}`, shown: `<i>${symbol}<sub>${axis}</sub></i>`, min: force ? -100 : -20, max: force ? 100 : 20, ...common,
      value: state.wrench[k], changed: (value) => update({ wrench: state.wrench.map((other, i) => (i === k ? value : other)) }),
    }));
    sliders.gains.push(slider($("gains"), {
      label: `stiffness ${force ? "along" : "about"} ${axis}`, shown: `<i>k<sub>${force ? axis : `r${axis}`}</sub></i>`, unit: force ? "N/m" : "N m/rad", min: force ? 10 : 1, max: force ? 2000 : 200, step: force ? 10 : 1,
      value: state.gains[k], changed: (value) => update({ gains: state.gains.map((other, i) => (i === k ? value : other)) }),
    }));
  });
  if (robot.floating) document.querySelector(".frame").textContent = "base, which is held at the origin of the world here";
  if (robot.runtimeTool) {
    slider($("tool"), {
      label: "tool's length along the tip's z", shown: "tool", unit: "mm", min: 0, max: 500, step: 5, value: 0,
      changed: (value) => {
        for (const tip of tips) tip.tool[11] = value / 1000;
        swing.stop();
        update();
      },
    });
  }
  options($("loop"), LOOPS.map(([, , text], k) => [k, text]));
  for (const id of ["first", "second"]) options($(id), robot.coordinates.map(({ name }, k) => [k, name]));
  const radius = () => {
    $("loop-sliders").replaceChildren();
    const metres = state.loop.kind === "carry" || (state.loop.kind === "joints" && robot.coordinates[state.loop.joints[0]].prismatic);
    slider($("loop-sliders"), {
      label: "radius of the loop", shown: "radius", unit: metres ? "mm" : "rad", min: metres ? 5 : 0.01, max: metres ? 300 : 0.5, step: metres ? 5 : 0.01,
      value: state.loop.radius * (metres ? 1000 : 1), changed: (value) => update({ loop: { ...state.loop, radius: metres ? value / 1000 : value } }),
    });
    sliders.lap = slider($("loop-sliders"), {
      label: "place on the loop", shown: "place", unit: "laps", min: 0, max: LAPS, step: 0.01, value: state.lap, changed: setLap,
    });
    for (const pair of document.querySelectorAll(".pair")) pair.hidden = state.loop.kind !== "joints";
  };
  const chooseLoop = () => {
    const [kind, axes] = LOOPS[$("loop").value];
    update({ loop: { ...state.loop, kind, axes, joints: [Number($("first").value), Number($("second").value)] } });
    radius();
  };
  $("loop").value = LOOPS.findIndex(([kind]) => kind === state.loop.kind);
  $("second").value = state.loop.joints[1];
  for (const id of ["loop", "first", "second"]) $(id).addEventListener("change", chooseLoop);
  radius();
  for (const name of ["translation", "rotation"]) {
    $(name).addEventListener("change", () => {
      state.show[name] = $(name).checked;
      redraw();
    });
  }
  for (const id of ["own", "chosen"]) $(id).addEventListener("change", () => update({ chosen: $("chosen").checked }));
  options($("tip"), robot.tips.map(({ link }, k) => [k, link]));
  $("tips").hidden = robot.tips.length < 2;
  $("tip").addEventListener("change", () => update({ tip: tips[$("tip").value] }));

  /** Set the configuration; the slider that moved (`by`) shows it already. */
  function posture(q, by = null) {
    const back = state.lap !== 0;
    [state.lap, state.going] = [0, false];
    if (back) sliders.lap.set(0);
    sliders.joints.forEach(({ k, set, scale }) => k !== by && set(q[k] * scale));
    update({ q });
  }
  const stand = (q) => {
    posture(q);
    compute();
    view?.fit();
  };
  const load = (wrench) => {
    sliders.wrench.forEach(({ set }, k) => set(wrench[k]));
    update({ wrench: Float64Array.from(wrench) });
  };
  const stiff = (gains) => {
    sliders.gains.forEach(({ set }, k) => set(gains[k]));
    update({ gains: gains.slice() });
  };
  /** Load the tip with a moment, and choose the direction of a wide loop in which the conventional law gives energy. */
  function giveEnergy() {
    load(MOMENT);
    update({ loop: { ...state.loop, radius: 0.3 } });
    for (const reversed of [false, true]) {
      state.loop = { ...state.loop, reversed };
      compute();
      if (now.works.conventional.at(-1) > 0) break;
    }
    radius();
    setLap(0);
    update();
  }
  let near = null, homeName = robot.paper ? "Paper's posture" : "Bent posture";
  if (robot.loops) homeName = "Start";
  const same = (a, b) => b !== null && a.every((value, k) => Math.abs(value - b[k]) < 1e-9);
  const gives = () => !robot.loops && same(state.wrench, MOMENT) && state.loop.radius === 0.3 && now.works.conventional.at(-1) > 0;
  const presets = [
    [homeName, () => { stand(home); load(WRENCH); stiff(GAINS); }, () => same(state.q, home) && same(state.wrench, WRENCH) && same(state.gains, GAINS)],
    ["Moment at the tip", () => load(MOMENT), () => same(state.wrench, MOMENT) && !gives()],
    ["Energy out of nothing", giveEnergy, gives, true],
    ["No load", () => load([0, 0, 0, 0, 0, 0]), () => same(state.wrench, [0, 0, 0, 0, 0, 0])],
    ["Near singular", () => { near = nearSingular(state.tip, home); stand(near); }, () => same(state.q, near), true],
  ].filter(([, , , needsTree]) => !(needsTree && robot.loops)).map(([text, act, holds]) => {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: text });
    button.addEventListener("click", act);
    return { button, holds };
  });
  $("presets").replaceChildren(...presets.map(({ button }) => button));
  /** Mark the presets whose values are those of the page. */
  function markPresets() {
    for (const { button, holds } of presets) button.setAttribute("aria-pressed", Boolean(holds()));
  }

  // ---- the arm
  compute();
  try {
    view = new View($("arm"), $("letters"), robot, {
      state: () => {
        const phase = 2 * Math.PI * state.lap;
        const arms = swing.arms();
        return { ...state, arms, q: arms || state.lap === 0 ? state.q : now.loop.at(phase), K: now.matrices.K, loop: now.path, marker: now.marker(phase) };
      },
      moved: posture,
      carried: (part) => setLap(state.lap + part),
      redraw,
    });
  } catch (error) {
    $("arm").parentElement.hidden = true;
    fail(`The arm is not drawn: ${error.message}. All the rest works.`);
  }
  new ResizeObserver(() => update()).observe(document.querySelector("main"));
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    colours = theme();
    update();
  });
  calm.addEventListener("change", redraw);
  update();
  // Access from the console and from tests.
  window.playground = { robot, kernels, tips, state, view, compute, swing, ends: () => loopEnds(robot, jointFrames(robot, state.q)), get now() { return now; } };
}

start().catch((error) => fail(`This page cannot start: ${error.message}`));
