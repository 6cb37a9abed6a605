// The playground's own modules without a browser: does what a request says, and prints the results as JSON.
// node play.mjs REQUEST.json, in a folder with the modules; numbers that JSON has not are null.

import { readFileSync } from "node:fs";
import { jointFrames, pointJacobian, tipFrame } from "./chain.js";
import { Press, criticalGain, pressing, softness, stretched } from "./compliance.js";
import { Body, DRIVES, flutterLimit } from "./drives.js";
import { startKernels } from "./kernels.js";
import * as mechanics from "./mechanics.js";
import { SWING_LAWS, Swing } from "./swing.js";
import { Hands } from "./twoarms.js";

const { data, wasm, tip: index, tasks } = JSON.parse(readFileSync(process.argv[2], "utf8"));
const kernels = await startKernels(Buffer.from(wasm, "base64"), data.functions, `${data.name}_self_check`);
const tip = new mechanics.Tip(data, index, kernels);
const hands = data.pair ? new Hands(data, data.tips.map((_, k) => new mechanics.Tip(data, k, kernels))) : null;
const plain = (value) => JSON.parse(JSON.stringify(value, (_, each) => (ArrayBuffer.isView(each) ? Array.from(each) : each)));

const DO = {
  call: ({ name, given }) => kernels.call(name, given),
  frames: ({ q, tool }) => {
    const frames = jointFrames(data, q);
    return tipFrame(data, data.tips[index], frames, data.runtimeTool ? tool : null);
  },
  point: ({ q, joint, point }) => pointJacobian(data, jointFrames(data, q), joint, point),
  matrices: ({ q, wrench, gains, chosen }) => mechanics.stiffnesses(tip, Float64Array.from(q), Float64Array.from(wrench), gains, chosen),
  loop: ({ q, wrench, gains, chosen, loop }) => {
    const [posture, F] = [Float64Array.from(q), Float64Array.from(wrench)];
    const closed = mechanics.closedLoop(tip, posture, loop);
    return mechanics.loopWork(tip, posture, F, mechanics.stiffnesses(tip, posture, F, gains, chosen), closed);
  },
  follow: ({ q, place, orientation }) => mechanics.follow(tip, Float64Array.from(q), place, Float64Array.from(orientation)),
  swing: ({ q, wrench, gains, damping, seconds }) => {
    const posture = Float64Array.from(q), matrices = mechanics.stiffnesses(tip, posture, Float64Array.from(wrench), gains, false);
    return SWING_LAWS.map((law) => {
      const swing = new Swing(tip, posture, matrices, law, damping);
      swing.advance(seconds);
      return { law, q: swing.q, made: swing.made, spring: matrices.spring };
    });
  },
  drag: ({ q, places, orientation }) => {
    let posture = Float64Array.from(q);
    return places.map((place) => (posture = mechanics.follow(tip, posture, place, Float64Array.from(orientation))));
  },
  softness: ({ q, wrench, gains }) => softness(tip, Float64Array.from(q), Float64Array.from(wrench), Float64Array.from(gains)),
  press: ({ q, force, gains, seconds }) => {
    const press = new Press(tip, Float64Array.from(q), force, Float64Array.from(gains));
    press.advance(seconds);
    return { q: press.q, gaveWay: press.gaveWay, ways: press.ways(), now: press.now };
  },
  straight: ({ q, strength }) => {
    const posture = stretched(tip, Float64Array.from(q)), force = pressing(tip, posture, strength);
    return { q: posture, force, critical: criticalGain(tip, posture, force) };
  },
  drives: ({ target, ratio, seconds }) => DRIVES.map((drive) => {
    const body = new Body(drive, target, ratio);
    body.advance(seconds);
    return { law: body.law, angle: body.angle() };
  }),
  limit: ({ target }) => flutterLimit(target),
  bent: () => mechanics.bentPosture(data),
  grasp: ({ q, reach }) => hands.grasp(Float64Array.from(q), reach),
  rest: ({ q, box, grasps }) => hands.rest(Float64Array.from(q), Float64Array.from(box), grasps.map((each) => Float64Array.from(each))),
  works: ({ q, radius, grasps, points }) => {
    const lap = hands.lap(Float64Array.from(q), radius), poses = grasps.map((each) => Float64Array.from(each));
    const way = Array.from({ length: points }, (_, k) => lap.at((2 * Math.PI * k) / points));
    return { way, works: hands.works(lap, poses) };
  },
  singular: ({ q }) => {
    const near = mechanics.nearSingular(tip, Float64Array.from(q));
    return [mechanics.distanceFromSingular(tip, Float64Array.from(q)), mechanics.distanceFromSingular(tip, near)];
  },
};
process.stdout.write(JSON.stringify(tasks.map((task) => plain(DO[task.do](task)))));
