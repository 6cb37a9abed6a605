// SPDX-License-Identifier: MIT
// The panel of the arm on joint springs: their gains, the compliance at the tip, and a press that makes the arm give way.

import { GAINS_OF, PRESS_SECONDS, Press, reachOfPush, sprung } from "./compliance.js";
import { drawCurves, number, shade } from "./figures.js";
import { distinct, record, slider } from "./panels.js";

const PRESS_EVERY = 0.02; // s between points of the figure
/** Return what the panel says of the ellipsoids. */
function textOfSoftness({ stability, loaded, usual }) {
  const said = (compliance) => reachOfPush(compliance).map((length) => `${number(1000 * length)} mm`).join(" to ");
  const without = `without the load's terms ${said(usual)}`;
  if (!loaded) return `No posture to hold: the smallest eigenvalue of H is ${number(stability)} N m/rad, so the arm gives way (${without}).`;
  return `20 N move the tip by ${said(loaded)}, according to the direction; ${without}. The smallest eigenvalue of H is ${number(stability)} N m/rad: the posture holds.`;
}

/** Return what the panel says of a press. */
function textOfPress(press) {
  const { loaded, usual } = press.ways(), newtons = (share) => number(share * Math.hypot(...press.force));
  const ways = `The tip has gone ${number(1000 * loaded)} mm; the usual formula says ${number(1000 * usual)} mm.`;
  return press.gaveWay === null
    ? `${newtons(press.share)} N: ${ways}`
    : `${newtons(press.share)} N: the arm gave way at ${newtons(press.gaveWay)} N. ${ways}`;
}

/** The panel of a page. */
export class CompliancePanel {
  constructor(page) {
    this.page = page;
    this.stop();
    this.sliders = this.gainSliders();
    page.$("press").addEventListener("click", () => this.pressOrBack());
  }

  /** Make a slider for all turning joints, and one for each joint. */
  gainSliders() {
    const { $, robot, state } = this.page, joints = sprung(robot), names = distinct(robot.coordinates.map(({ name }) => name));
    const parent = $("joint-gains"), turning = joints.filter((k) => !robot.coordinates[k].prismatic);
    const control = (given) => slider(parent, { min: 1, step: 1, ...given });
    if (turning.length > 1) {
      this.all = control({
        label: "gain of all turning joints", shown: "all", unit: "N m/rad", max: GAINS_OF.turning.most, value: GAINS_OF.turning.start,
        changed: (value) => this.hold(joints.map((k, i) => (robot.coordinates[k].prismatic ? state.jointGains[i] : value))),
      });
    }
    return joints.map((k, i) => {
      const { most, unit } = GAINS_OF[robot.coordinates[k].prismatic ? "sliding" : "turning"], text = Object.assign(document.createElement("i"), { textContent: names[k] });
      return control({
        label: `gain of joint ${k + 1}, ${robot.coordinates[k].name}`, shown: text.innerHTML, colour: shade(k), max: most,
        unit, value: state.jointGains[i],
        changed: (value) => this.hold(state.jointGains.map((other, each) => (each === i ? value : other)), i),
      });
    });
  }

  /** Set the gains of the joint springs; the slider that moved (`by`) shows its own already. */
  hold(gains, by = null) {
    this.sliders.forEach(({ set }, k) => k !== by && set(gains[k]));
    if (gains.every((gain) => gain === gains[0])) this.all?.set(gains[0]);
    this.page.update({ jointGains: Float64Array.from(gains) });
  }

  /** Press the arm, or put it back; without motion, show the end. */
  pressOrBack() {
    const { page } = this, { tip, q, wrench, jointGains } = page.state;
    const wasPressed = this.press !== null;
    page.update({ lap: 0, going: false });
    if (wasPressed) return;
    page.loop.place(0);
    this.press = new Press(tip, q, wrench.slice(0, 3), jointGains);
    this.curves = { exact: [0], conventional: [0] };
    this.going = !page.calm.matches;
    page.showSoftness();
    if (!this.going) this.advance(PRESS_SECONDS);
  }

  stop() {
    [this.press, this.going, this.curves] = [null, false, { exact: [], conventional: [] }];
  }

  advance(seconds) {
    const { press, curves } = this;
    if (!press) return;
    const until = Math.min(PRESS_SECONDS, press.time + seconds);
    record(press, until, PRESS_EVERY, curves, () => {
      const { loaded, usual } = press.ways();
      return { exact: 1000 * loaded, conventional: 1000 * usual };
    });
    if (until >= PRESS_SECONDS - 1e-9) this.going = false;
  }

  /** Return the softness of the arm as it stands, or as it is pressed. */
  softness() {
    return this.press?.now ?? this.page.now.soft;
  }

  /** Return what a press shows in place of the state: {q, wrench, no loop}, or null. */
  shown() {
    return this.press && { q: this.press.q, wrench: this.press.wrench, loop: null };
  }

  show(colours) {
    const { $, state } = this.page, strong = Math.hypot(...state.wrench.slice(0, 3));
    $("press").disabled = !this.press && strong === 0;
    $("press").textContent = this.press ? "Back to the start" : "Press";
    const words = strong === 0 ? "Give the wrench a force, and press." : `Press: the force of ${number(strong)} N grows from zero in 3 s.`;
    $("press-text").textContent = this.press ? textOfPress(this.press) : words;
    $("softness").textContent = textOfSoftness(this.softness());
    drawCurves($("press-way"), Object.entries(this.curves), PRESS_EVERY, PRESS_SECONDS, "way of the tip [mm]", colours);
  }
}
