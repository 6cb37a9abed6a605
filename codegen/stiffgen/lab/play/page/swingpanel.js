// SPDX-License-Identifier: MIT
// The panel of the push: start, stop, damping, and the figure of what the arm does after it.

import { norm, plus } from "./algebra.js";
import { drawCurves, number } from "./figures.js";
import { originOf } from "./mechanics.js";
import { record, slider } from "./panels.js";
import { SWING_LAWS, SWING_SECONDS, Swing } from "./swing.js";

const EVERY = 0.01; // s between points of the figure

/** Return what the panel says of the spring, and of the energy that each law has made. */
function swingText(spring, swings) {
  if (!spring) return "No spring with these gains bears this wrench, so there is nothing to let go of.";
  if (!swings) return "The wrench holds the spring under tension. Let go, and the arm swings.";
  const made = swings.map((swing) => `${swing.law} ${Math.abs(swing.made) < 1e-4 ? "0 J" : `${number(swing.made)} J`}`);
  return `After ${swings[0].time.toFixed(2)} s, energy made out of nothing: ${made.join(", ")}.`;
}

/**
 * Wire the panel. `state` and `now()` are the page's; `redraw` asks for a frame. Gives {advance(seconds), show(colours),
 * stop(), arms()}: arms() are the laws with their postures while they swing, else null.
 */
export function swingPanel({ $, state, now, redraw, calm }) {
  let swings = null, curves = {}, damping = 0.3, going = false;
  const panel = $("swing-panel");
  panel.hidden = !state.tip.hasMasses;
  slider($("damping"), {
    label: "damping rate", shown: "damping", unit: "1/s", min: 0, max: 5, step: 0.1, value: damping,
    changed: (value) => { damping = value; stop(); redraw(); },
  });

  function begin() {
    if (!now().matrices.spring) return;
    swings = SWING_LAWS.map((law) => new Swing(state.tip, state.q, now().matrices, law, damping));
    curves = Object.fromEntries(SWING_LAWS.map((law) => [law, { way: [0], made: [0] }]));
    going = !calm.matches;
    if (!going) advance(SWING_SECONDS); // without motion: the figure alone
  }

  function advance(seconds) {
    if (!swings) return;
    const until = Math.min(SWING_SECONDS, swings[0].time + seconds);
    for (const swing of swings) {
      const from = originOf(state.tip.pose(swing.start));
      record(swing, until, EVERY, curves[swing.law], () => ({
        way: 1000 * norm(plus(originOf(state.tip.pose(swing.q)), from, -1)), made: swing.made,
      }));
    }
    if (until >= SWING_SECONDS - 1e-9) going = false;
  }

  function stop() {
    [swings, going] = [null, false];
  }

  function show(colours) {
    const { spring } = now().matrices;
    $("let-go").disabled = !spring;
    $("let-go").textContent = swings ? "Back to the start" : "Let go";
    const laws = swings ? SWING_LAWS : [];
    drawCurves($("swing-way"), laws.map((law) => [law, curves[law].way]), EVERY, SWING_SECONDS, "way of the tip [mm]", colours);
    drawCurves($("swing-made"), laws.map((law) => [law, curves[law].made]), EVERY, SWING_SECONDS, "energy made [J]", colours);
    $("swing-text").textContent = swingText(spring, swings);
  }

  $("let-go").addEventListener("click", () => {
    if (swings) stop();
    else begin();
    redraw();
  });
  return {
    advance: (seconds) => going && advance(seconds), show, stop,
    get going() { return going; },
    arms: () => (swings ? swings.map(({ law, q }) => ({ law, q })) : null),
  };
}
