// SPDX-License-Identifier: MIT
// The panel of two arms that hold a box: its pose, and the work of two laws on a lap of the hands.

import { largest, multiply, plus, turn } from "./algebra.js";
import { reach } from "./chain.js";
import { drawCurves, number } from "./figures.js";
import { originOf, rotationOf } from "./mechanics.js";
import { slider } from "./panels.js";
import { Hands, LAP_POINTS, poseOf } from "./twoarms.js";

const LAP_SECONDS = 4;
const AXES = ["x", "y", "z"];

/** The panel of a page whose robot has a pair. */
export class TwoArmsPanel {
  constructor(page) {
    Object.assign(this, { page, hands: new Hands(page.robot, page.tips), home: null, radius: 0.3 });
    this.stop();
    const { $ } = page, far = 10 * Math.round(40 * reach(page.robot));
    $("two-arms-panel").hidden = false;
    this.sliders = [0, 3].flatMap((first) => AXES.map((axis, k) => slider($("box-sliders"), {
      label: `box ${first ? "about" : "along"} ${axis}`, shown: `${first ? "about" : "along"} <i>${axis}</i>`, value: 0, step: 1,
      ...(first ? { min: -90, max: 90, unit: "deg" } : { min: -far, max: far, unit: "mm" }),
      changed: (value) => this.moved(first + k, value * (first ? Math.PI / 180 : 1e-3)),
    })));
    slider($("box-sliders"), {
      label: "swing of each joint on the lap, less near a limit", shown: "swing", unit: "rad", min: 0.05, max: 0.8, step: 0.05, value: this.radius,
      changed: (value) => {
        this.radius = value;
        this.leave();
      },
    });
    $("box-hold").addEventListener("click", () => (this.held ? page.update({ lap: 0, going: false }) : this.hold()));
    $("box-lap").addEventListener("click", () => this.round());
  }

  /** Take hold of the box: the hands of the page's first posture come to its ends. */
  hold() {
    const { page } = this;
    page.update({ lap: 0, going: false });
    page.loop.place(0);
    this.home ??= this.hands.grasp(page.home, reach(page.robot));
    this.held = { ...this.home };
    page.view?.fit();
    page.redraw();
  }

  stop() {
    Object.assign(this, { held: null, going: false, turned: null, way: new Float64Array(6) });
    this.sliders?.forEach(({ set }) => set(0));
  }

  /** Come back from a lap, with the box in the hands. */
  leave() {
    [this.turned, this.going] = [null, false];
    this.page.redraw();
  }

  /** Return the pose to which the box is drawn: its first one, carried and turned along the base's axes. */
  get goal() {
    const { box } = this.home, R = multiply(turn(this.way.slice(3)), rotationOf(box), 3, 3, 3);
    return poseOf(R, plus(originOf(box), this.way.slice(0, 3)));
  }

  /** Carry (k < 3) [m] or turn [rad] the box; the hands follow by their springs. */
  moved(k, value) {
    if (!this.held) this.hold();
    this.way[k] = value;
    this.follow();
  }

  /** Carry the middle of the box to a place, as a drag says. */
  carry(place) {
    this.way.set(plus(place, originOf(this.home.box), -1));
    AXES.forEach((_, k) => this.sliders[k].set(1e3 * this.way[k]));
    this.follow();
  }

  follow() {
    this.held.q = this.hands.rest(this.held.q, this.goal, this.held.grasps);
    this.leave();
  }

  /** Go round a lap; without motion, show its end. */
  round() {
    const { page, hands } = this;
    if (!this.held) this.hold();
    const lap = hands.lap(this.held.q, this.radius);
    this.turned = { ...lap, done: 0, works: hands.works(lap, this.held.grasps) };
    this.going = !page.calm.matches;
    if (!this.going) this.advance(LAP_SECONDS);
    page.redraw();
  }

  advance(seconds) {
    this.turned.done = Math.min(1, this.turned.done + seconds / LAP_SECONDS);
    if (this.turned.done >= 1) this.going = false;
  }

  /** Return what the picture shows in place of the state: arms, box, and on a lap where each hand says that the box is. */
  shown() {
    if (!this.held) return null;
    const { hands, held, turned } = this, { grasps, half } = held, onWay = turned && turned.done < 1;
    const q = onWay ? turned.at(2 * Math.PI * turned.done) : held.q;
    const poses = onWay ? hands.claims(q, grasps) : [hands.boxOf(q, grasps)];
    const boxes = poses.map((pose) => ({ pose, half, opacity: onWay ? 0.5 : 1 }));
    return { q, wrench: new Float64Array(6), loop: null, ellipsoids: [], boxes, goal: onWay ? null : originOf(this.goal) };
  }

  /** Return what the panel says of the lap. */
  said() {
    const { turned, held } = this;
    if (!turned) return held ? "Drag the box, or go round." : "";
    const { conventional, exact } = turned.works, rounding = 1e-12 * Math.max(1, largest(exact));
    const joules = (work) => (Math.abs(work.at(-1)) <= rounding ? "0 J" : `${number(work.at(-1))} J`);
    return `A lap puts out ${joules(conventional)} by K times the rotation vector, ${joules(exact)} by the spring of the pair.`;
  }

  show(colours) {
    const { $ } = this.page, { turned } = this;
    $("box-hold").textContent = this.held ? "Back to the start" : "Hold the box";
    $("box-lap").textContent = this.turned ? "Go round again" : "Go round";
    $("box-text").textContent = this.said();
    const count = turned ? Math.round(LAP_POINTS * turned.done) + 1 : 0;
    const curves = Object.entries(turned?.works ?? {}).map(([law, work]) => [law, Array.from(work.slice(0, count))]);
    drawCurves($("box-work"), curves, LAP_SECONDS / LAP_POINTS, LAP_SECONDS, "work put out [J]", colours);
  }
}
