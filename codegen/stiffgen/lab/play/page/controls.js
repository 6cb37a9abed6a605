// SPDX-License-Identifier: MIT
// Sliders of joints, wrench and gains, and the choices of tool, tip and ellipsoids.

import { rangeOf } from "./chain.js";
import { shade } from "./figures.js";
import { withJoint } from "./motorpanel.js";
import { distinct, options, slider } from "./panels.js";
import { DEGREES } from "./values.js";

/** Return a slider for each joint that can be moved, with its index k and its scale from q to the unit shown. */
function jointSliders(page) {
  const { $, robot, state } = page, names = distinct(robot.coordinates.map(({ name }) => name));
  const longest = Math.min(14, Math.max(4, ...names.map(({ length }) => length)));
  $("joints").style.setProperty("--name", `calc(${longest}ch + 1.4rem)`);
  return robot.coordinates.flatMap((coordinate, k) => {
    const { name, prismatic } = coordinate;
    if (robot.loops && !robot.loops.actuated.includes(k)) return [];
    const scale = prismatic ? 1000 : DEGREES, [from, to] = rangeOf(coordinate, prismatic ? 1 : Math.PI);
    const text = Object.assign(document.createElement("i"), { textContent: names[k] });
    const made = slider($("joints"), {
      label: `joint ${k + 1}, ${name}`, shown: text.innerHTML, unit: prismatic ? "mm" : "deg",
      min: from * scale, max: to * scale, step: 0.1,
      value: state.q[k] * scale, colour: shade(k), limited: true,
      changed: (value) => page.posture(withJoint(page, k, value / scale), k),
    });
    return [{ k, scale, ...made }];
  });
}

/** Return a copy of a list with entry k changed. */
function changed(list, k, value) {
  return list.map((other, i) => (i === k ? value : other));
}

/** Return the slider of component k of the wrench. */
function wrenchSlider(page, axis, k) {
  const force = k < 3, most = force ? 100 : 20;
  return slider(page.$("wrench"), {
    label: `${force ? "force" : "moment"} along ${axis}`, shown: `<i>${force ? "f" : "m"}<sub>${axis}</sub></i>`,
    min: -most, max: most, step: force ? 1 : 0.1, unit: force ? "N" : "N m", value: page.state.wrench[k],
    changed: (value) => page.update({ wrench: changed(page.state.wrench, k, value) }),
  });
}

/** Return the slider of gain k. */
function gainSlider(page, axis, k) {
  const force = k < 3;
  return slider(page.$("gains"), {
    label: `stiffness ${force ? "along" : "about"} ${axis}`, shown: `<i>k<sub>${force ? axis : `r${axis}`}</sub></i>`,
    unit: force ? "N/m" : "N m/rad", min: force ? 10 : 1, max: force ? 2000 : 200, step: force ? 10 : 1,
    value: page.state.gains[k], changed: (value) => page.update({ gains: changed(page.state.gains, k, value) }),
  });
}

/** Wire tool, tip and ellipsoids. */
function wireChoices(page) {
  const { $, robot, state, tips } = page;
  if (robot.floating) document.querySelector(".frame").textContent = "base, which is held at the origin of the world here";
  if (robot.runtimeTool) {
    slider($("tool"), {
      label: "tool's length along the tip's z", shown: "tool", unit: "mm", min: 0, max: 500, step: 5, value: 0,
      changed: (value) => {
        for (const tip of tips) tip.tool[11] = value / 1000;
        page.stopMotions();
        page.update();
      },
    });
  }
  for (const name of ["translation", "rotation", "compliance"]) {
    $(name).addEventListener("change", () => {
      state.show[name] = $(name).checked;
      page.redraw();
    });
  }
  for (const id of ["own", "chosen"]) $(id).addEventListener("change", () => page.update({ chosen: $("chosen").checked }));
  options($("tip"), robot.tips.map(({ link }, k) => [k, link]));
  $("tips").hidden = robot.tips.length < 2;
  $("tip").addEventListener("change", () => page.update({ tip: tips[$("tip").value] }));
}

/** Wire the controls. Gives {showJoints(q, by), load(wrench), stiffen(gains)}. */
export function controlPanel(page) {
  const axes = ["x", "y", "z", "x", "y", "z"], joints = jointSliders(page);
  const wrench = axes.map((axis, k) => wrenchSlider(page, axis, k)), gains = axes.map((axis, k) => gainSlider(page, axis, k));
  wireChoices(page);
  return {
    showJoints: (q, by) => joints.forEach(({ k, set, scale }) => k !== by && set(q[k] * scale)),
    load(values) {
      wrench.forEach(({ set }, k) => set(values[k]));
      page.update({ wrench: Float64Array.from(values) });
    },
    stiffen(values) {
      gains.forEach(({ set }, k) => set(values[k]));
      page.update({ gains: values.slice() });
    },
  };
}
