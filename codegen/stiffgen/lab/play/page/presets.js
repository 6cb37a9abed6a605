// SPDX-License-Identifier: MIT
// Buttons that set the page to a situation worth seeing.

import { criticalGain, pressing, stretched } from "./compliance.js";
import { nearSingular } from "./mechanics.js";
import { GAINS, MOMENT, WRENCH } from "./values.js";

const WIDE = 0.3; // radius of the loop on which the conventional law gives energy
const PRESSING = 80, SOFT = 0.7; // N, and the gains as a part of those at which the arm gives way

/** Return whether two lists have the same values, up to rounding. */
function alike(a, b) {
  return b !== null && a.every((value, k) => Math.abs(value - b[k]) < 1e-9);
}

/** Load the tip with a moment, and choose the direction of a wide loop in which the conventional law gives energy. */
function giveEnergy(page) {
  const { state } = page;
  page.controls.load(MOMENT);
  page.update({ loop: { ...state.loop, radius: WIDE } });
  for (const reversed of [false, true]) {
    state.loop = { ...state.loop, reversed };
    page.compute();
    if (page.now.works.conventional.at(-1) > 0) break;
  }
  page.loop.fill();
  page.loop.setLap(0);
  page.update();
}

/** Stretch the arm, and press it towards its base on joint springs that cannot hold it. */
function giveWay(page, home) {
  const { state, compliance } = page, straight = stretched(state.tip, home), force = pressing(state.tip, straight, PRESSING);
  page.stand(straight);
  page.controls.load(force);
  compliance.hold(state.jointGains.map(() => Math.max(1, SOFT * criticalGain(state.tip, straight, force))));
  compliance.pressOrBack();
}

/** Return the presets: name, what sets them, whether the page is there, the panel that shows it, and whether they need a tree or a pair. */
function presetsOf(page, home) {
  const { state, robot } = page, { load, stiffen } = page.controls;
  let near = null, homeName = robot.paper ? "Paper's posture" : "Bent posture";
  if (robot.loops) homeName = "Start";
  const gives = () => !robot.loops && alike(state.wrench, MOMENT) && state.loop.radius === WIDE && page.now.works.conventional.at(-1) > 0;
  return [
    {
      name: homeName, act() { page.stand(home); load(WRENCH); stiffen(GAINS); },
      holds: () => alike(state.q, home) && alike(state.wrench, WRENCH) && alike(state.gains, GAINS),
    },
    { name: "Moment at the tip", act: () => load(MOMENT), holds: () => alike(state.wrench, MOMENT) && !gives(), panel: "matrix-title" },
    { name: "Energy out of nothing", act: () => giveEnergy(page), holds: gives, needsTree: true, panel: "loop-title" },
    { name: "No load", act: () => load([0, 0, 0, 0, 0, 0]), holds: () => alike(state.wrench, [0, 0, 0, 0, 0, 0]), panel: "matrix-title" },
    {
      name: "Near singular", act() { near = nearSingular(state.tip, home); page.stand(near); },
      holds: () => alike(state.q, near), needsTree: true, panel: "matrix-title",
    },
    {
      name: "A ball joint", act() { page.drives.stop(); page.drives.push(); },
      holds: () => page.drives.bodies() !== null, panel: "drive-title",
    },
    {
      name: "Two arms on a box", act: () => page.twoArms.hold(),
      holds: () => page.twoArms.held !== null, needsPair: true, panel: "two-arms-title",
    },
    { name: "Gives way", act: () => giveWay(page, home), holds: () => page.compliance.press !== null, panel: "softness-title" },
  ].filter(({ needsTree, needsPair }) => !(needsTree && robot.loops) && !(needsPair && !robot.pair));
}

/** Scroll to a panel's title, unless it is in view; a closed loop's page lacks some panels. */
function show(title) {
  if (!title.checkVisibility()) return;
  const { top } = title.getBoundingClientRect();
  if (top < 0 || top > 0.6 * window.innerHeight) title.scrollIntoView({ block: "start" });
}

/** Make the buttons. Gives {mark()}, which marks the last one pressed while its values are the page's; at first, the first. */
export function presetButtons(page, home) {
  const made = presetsOf(page, home).map(({ name, act, holds, panel }) => {
    const button = Object.assign(document.createElement("button"), { type: "button", textContent: name });
    button.addEventListener("click", () => {
      pressed = button;
      act();
      if (panel) show(page.$(panel));
    });
    return { button, holds };
  });
  let pressed = made[0].button;
  page.$("presets").replaceChildren(...made.map(({ button }) => button));
  return {
    mark() {
      for (const { button, holds } of made) button.setAttribute("aria-pressed", button === pressed && Boolean(holds()));
    },
  };
}
