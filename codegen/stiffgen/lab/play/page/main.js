// SPDX-License-Identifier: MIT
// The page: its parts, and the frames that show the values computed from its state.

import { loopEnds, jointFrames } from "./chain.js";
import { CompliancePanel } from "./compliancepanel.js";
import { controlPanel } from "./controls.js";
import { DrivePanel } from "./drivepanel.js";
import { LAPS, theme } from "./figures.js";
import { startKernels } from "./kernels.js";
import { LoopPanel } from "./looppanel.js";
import { matrixPanel } from "./matrixpanel.js";
import { Tip, bentPosture } from "./mechanics.js";
import { showMotors } from "./motorpanel.js";
import { presetButtons } from "./presets.js";
import { swingPanel } from "./swingpanel.js";
import { TwoArmsPanel } from "./twoarmspanel.js";
import { ellipsoidsOf, startState, valuesOf } from "./values.js";
import { View } from "./view.js";

const SECONDS = 4; // a lap takes
const $ = (id) => document.getElementById(id);

function fail(text) {
  $("failure").textContent = text;
  $("failure").hidden = false;
}

/** The page of a robot: state, values (now), parts, and when they are computed and shown. */
class Page {
  constructor(robot, kernels) {
    Object.assign(this, { $, robot, kernels, now: {}, view: null, colours: theme(), last: null });
    this.waiting = { compute: true, frame: false };
    this.calm = window.matchMedia("(prefers-reduced-motion: reduce)");
    this.tips = robot.tips.map((_, k) => new Tip(robot, k, kernels));
    const known = robot.loops?.start ?? robot.paper, start = known ? Float64Array.from(known) : bentPosture(robot);
    const home = this.home = robot.loops ? this.tips[0].movedTo(start, start) : start; // closed to the last digit
    this.state = startState(this.tips[0], home);
    this.swing = swingPanel({ $, state: this.state, now: () => this.now, redraw: () => this.redraw(), calm: this.calm });
    this.matrices = matrixPanel(this);
    this.controls = controlPanel(this);
    this.loop = new LoopPanel(this);
    this.compliance = new CompliancePanel(this);
    this.drives = new DrivePanel(this);
    this.twoArms = robot.pair ? new TwoArmsPanel(this) : null;
    this.motions = [this.swing, this.compliance, this.drives, this.twoArms].filter(Boolean);
    this.presets = presetButtons(this, home);
  }

  /** Compute the values of the state. All calls of kernels but the swing's are here. */
  compute() {
    this.now = valuesOf(this.robot, this.state);
  }

  /** Change the state, and show it in the next frame. */
  update(change = {}) {
    Object.assign(this.state, change);
    if (Object.keys(change).length) this.stopMotions(); // not where only the window changed
    this.waiting.compute = true;
    this.redraw();
  }

  /** Put the arm back to where it stands. */
  stopMotions() {
    for (const motion of this.motions) motion.stop();
  }

  /** Whether something moves by itself. */
  get moves() {
    return this.state.going || this.motions.some(({ going }) => going);
  }

  /** Ask for a frame. */
  redraw() {
    if (this.waiting.frame) return;
    this.waiting.frame = true;
    requestAnimationFrame((time) => this.frame(time));
  }

  /** Move on by the time [ms] since the last frame, where something moves. */
  advance(time) {
    const { state, last } = this, passed = last === null ? 0 : time - last;
    if (state.going) {
      state.lap += Math.min(100, passed) / 1000 / SECONDS;
      if (state.lap >= LAPS) [state.lap, state.going] = [LAPS, false];
      this.loop.place(state.lap);
    }
    for (const motion of this.motions) if (motion.going) motion.advance(Math.min(33, passed) / 1000);
    this.last = this.moves ? time : null;
  }

  /** Compute and show what depends on the state. */
  refresh() {
    this.compute();
    if (this.robot.loops) showMotors(this);
    else this.matrices.showMatrices();
    this.matrices.showEllipsoids();
  }

  frame(time) {
    this.waiting.frame = false;
    this.advance(time);
    if (this.waiting.compute) this.refresh();
    this.waiting.compute = false;
    this.view?.draw();
    if (!this.robot.loops) this.loop.show();
    $("timing").textContent = `Kernels of this picture: ${this.now.time.toFixed(1)} ms.`;
    for (const motion of this.motions) motion.show(this.colours);
    this.presets.mark();
    if (!performance.getEntriesByName("first picture").length) performance.mark("first picture");
    if (this.moves) this.redraw();
  }

  /** Set the configuration; the slider that moved (`by`) shows it already. */
  posture(q, by = null) {
    const { state } = this, back = state.lap !== 0;
    [state.lap, state.going] = [0, false];
    if (back) this.loop.place(0);
    this.controls.showJoints(q, by);
    this.update({ q });
  }

  /** Set the configuration, and fit the view to it. */
  stand(q) {
    this.posture(q);
    this.compute();
    this.view?.fit();
  }

  /** Show the ellipsoids of the compliance in the picture, and not those of the spring at the tip. */
  showSoftness() {
    this.state.show = { translation: false, rotation: false, compliance: true };
    for (const [name, shown] of Object.entries(this.state.show)) $(name).checked = shown;
    this.redraw();
  }

  /** Return the state as the view shows it: on the loop, swinging, pressed, or with a box. */
  shown() {
    const { state, now } = this, phase = 2 * Math.PI * state.lap, arms = this.drives.bodies() ?? this.swing.arms();
    const q = arms || state.lap === 0 ? state.q : now.loop.at(phase);
    const ellipsoids = ellipsoidsOf(this.robot, state.show, now.matrices.K, this.compliance.softness());
    return { ...state, arms, q, ellipsoids, loop: now.path, marker: now.marker(phase), ...this.compliance.shown(), ...this.twoArms?.shown() };
  }

  /** Draw the arm, or say why not. */
  startView() {
    try {
      this.view = new View($("arm"), $("letters"), this.robot, {
        state: () => this.shown(),
        moved: (q) => this.posture(q),
        boxed: (place) => this.twoArms.carry(place),
        carried: (part) => this.loop.setLap(this.state.lap + part),
        redraw: () => this.redraw(),
      });
    } catch (error) {
      $("arm").parentElement.hidden = true;
      fail(`The arm is not drawn: ${error.message}. All the rest works.`);
    }
  }

  /** Follow the window's size, its colours, and the wish for less motion. */
  watchWindow() {
    new ResizeObserver(() => this.update()).observe(document.querySelector("main"));
    window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      this.colours = theme();
      this.update();
    });
    this.calm.addEventListener("change", () => this.redraw());
  }

  /** Return the ends of the loops' joints, for tests. */
  ends() {
    return loopEnds(this.robot, jointFrames(this.robot, this.state.q));
  }
}

async function start() {
  const robot = JSON.parse($("data").textContent);
  const bytes = Uint8Array.from(atob($("wasm").textContent), (letter) => letter.charCodeAt(0));
  const kernels = await startKernels(bytes, robot.functions, `${robot.name}_self_check`);
  for (const each of document.querySelectorAll(".of-tree")) each.hidden = Boolean(robot.loops);
  $("motors-panel").hidden = !robot.loops;
  const page = new Page(robot, kernels);
  page.compute();
  page.startView();
  page.watchWindow();
  page.update();
  window.playground = page; // access from the console and from tests
}

start().catch((error) => fail(`This page cannot start: ${error.message}`));
