// SPDX-License-Identifier: MIT
// The panel of the ball joint: target, damping, a push, and how far three drives are from their target after it.

import { Body, DRIVES, DRIVE_SECONDS, flutterLimit } from "./drives.js";
import { drawCurves, number } from "./figures.js";
import { record, slider } from "./panels.js";

const DRIVE_EVERY = 0.02; // s between points of the figure
const STILL = 1e-4; // rad, that are told as 0

/** The panel of a page. */
export class DrivePanel {
  constructor(page) {
    this.page = page;
    [this.target, this.ratio] = [0.9, 0.1];
    this.stop();
    const { $ } = page, changed = (name) => (value) => {
      this[name] = value;
      page.update({ lap: 0, going: false });
    };
    slider($("drive-sliders"), { label: "target of the ball joint", shown: "target", unit: "rad", min: 0.1, max: 2.5, step: 0.1, value: this.target, changed: changed("target") });
    slider($("drive-sliders"), { label: "damping ratio of the drives", shown: "damping", unit: "", min: 0, max: 1, step: 0.01, value: this.ratio, changed: changed("ratio") });
    $("push").addEventListener("click", () => this.push());
  }

  /** Push the bodies, or put the arm back into the picture; without motion, show the end. */
  push() {
    const { page } = this, wasPushed = this.pushed !== null;
    page.update({ lap: 0, going: false });
    if (wasPushed) return;
    this.pushed = DRIVES.map((drive) => new Body(drive, this.target, this.ratio));
    this.curves = Object.fromEntries(this.pushed.map((body) => [body.law, [body.angle()]]));
    this.going = !page.calm.matches;
    if (!this.going) this.advance(DRIVE_SECONDS);
    page.redraw();
  }

  stop() {
    [this.pushed, this.going, this.curves] = [null, false, {}];
  }

  advance(seconds) {
    const until = Math.min(DRIVE_SECONDS, this.pushed[0].time + seconds);
    for (const body of this.pushed) record(body, until, DRIVE_EVERY, { angle: this.curves[body.law] }, () => ({ angle: body.angle() }));
    if (until >= DRIVE_SECONDS - 1e-9) this.going = false;
  }

  /** Return the bodies that the picture shows in place of the arm: {law, words, rotation}, or null. */
  bodies() {
    return this.pushed;
  }

  show(colours) {
    const { $ } = this.page, limit = flutterLimit(this.target);
    $("push").textContent = this.pushed ? "Back to the arm" : "Push";
    const promise = `Three position drives flutter about ${number(this.target)} rad below the damping ratio ${number(limit)}.`;
    const said = (angle) => (angle < STILL ? "0 rad" : `${number(angle)} rad`);
    const angles = this.pushed?.map((body) => `${body.words} ${said(body.angle())}`).join(", ");
    $("push-text").textContent = angles ? `After ${this.pushed[0].time.toFixed(2)} s, away from the target: ${angles}.` : promise;
    drawCurves($("drive-angle"), Object.entries(this.curves), DRIVE_EVERY, DRIVE_SECONDS, "way from the target [rad]", colours);
  }
}
