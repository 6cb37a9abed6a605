// SPDX-License-Identifier: MIT
// The arm as solids, the camera, and the actions of pointer and keys.

import { cross, dot, eigen, multiply, norm, plus, transpose } from "./algebra.js";
import { jointFrames, loopEnds, placed, pointJacobian, reach, tipFrame } from "./chain.js";
import { shade, theme } from "./figures.js";
import { follow, guardedStep, originOf, rotationOf } from "./mechanics.js";
import { Solids, flattened, model } from "./solids.js";

const FIELD = (34 * Math.PI) / 180; // of view, upwards
const scaled = (a, factor) => Array.from(a, (x) => x * factor);
const unit = (a) => scaled(a, 1 / (norm(a) || 1));
const rgb = (hex) => [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255);

/** Return two directions that form a right-handed triad with `z`. */
function beside(z) {
  const x = unit(cross(Math.abs(z[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0], z));
  return [x, cross(z, x)];
}

/** Return the distance of a ray from a segment, and the nearest place along the ray. */
function rayToSegment(eye, way, from, to) {
  const along = plus(to, from, -1), between = plus(eye, from, -1), b = dot(way, along), c = dot(along, along);
  const d = dot(way, between), e = dot(along, between), bottom = c - b * b;
  const s = Math.min(1, Math.max(0, bottom > 1e-12 ? (e - b * d) / bottom : 0));
  const t = dot(plus(plus(from, along, s), eye, -1), way);
  return { distance: norm(plus(plus(eye, way, t), plus(from, along, s), -1)), depth: t };
}

/**
 * The arm on a canvas. `state()` gives what is to be seen: {tip, q, ellipsoids, wrench, loop, marker}, and
 * with a box {boxes, goal}; `moved(q)`, `carried(part of a lap)`, `boxed(place)` are told what a drag did.
 */
export class View {
  constructor(canvas, letters, robot, { state, moved, carried, boxed, redraw }) {
    Object.assign(this, { canvas, robot, state, moved, carried, boxed, redraw });
    this.solids = new Solids(canvas);
    this.size = reach(robot);
    this.thick = this.size * 0.055;
    this.letters = ["x", "y", "z"].map((text) => {
      const span = document.createElement("span");
      span.textContent = text;
      letters.append(span);
      return span;
    });
    this.names = letters.appendChild(document.createElement("div"));
    this.names.className = "laws";
    this.pointers = new Map();
    this.home();
    // A touch that takes hold of something moves it; a vertical swipe beside the arm scrolls the page (touch-action).
    canvas.addEventListener("touchstart", (event) => {
      const { left, top } = canvas.getBoundingClientRect(), [{ clientX, clientY }] = event.touches;
      if (event.touches.length > 1 || this.grabbed(clientX - left, clientY - top, 1.8)) event.preventDefault();
    }, { passive: false });
    canvas.addEventListener("pointerdown", (event) => this.pressed(event));
    canvas.addEventListener("pointermove", (event) => this.dragged(event));
    for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => this.released(event));
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY * 0.001));
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("webglcontextrestored", () => redraw());
  }

  home() {
    this.azimuth = -0.9;
    this.elevation = 0.32;
    this.fit();
  }

  /** Look at the middle of the arm, from a place where all of it and the drawings about the tip are visible. */
  fit() {
    const { tip, q, loop } = this.state(), { links, tip: hand } = this.parts(tip, q), about = 0.36 * this.size;
    const points = [...links.flatMap(({ from, to }) => [from, to]), ...(loop ?? [])];
    points.push(plus(hand.origin, [1, 1, 1], about), plus(hand.origin, [1, 1, 1], -about));
    const ends = [0, 1, 2].map((k) => points.map((point) => point[k])).map((x) => [Math.min(0, ...x), Math.max(0, ...x)]);
    this.target = ends.map(([low, high]) => (low + high) / 2);
    const half = norm(ends.map(([low, high]) => (high - low) / 2)) + 0.04 * this.size;
    this.distance = half / Math.sin(FIELD / 2);
    this.redraw();
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, 0.5 * this.size), 8 * this.size);
    this.redraw();
  }

  look(right, up) {
    this.azimuth -= right;
    this.elevation = Math.min(Math.max(this.elevation + up, -1.5), 1.5);
    this.redraw();
  }

  camera(parts = 1) {
    const { azimuth: a, elevation: e } = this;
    const back = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    const right = [-Math.sin(a), Math.cos(a), 0], up = cross(back, right);
    const wide = this.canvas.clientWidth / parts / Math.max(1, this.canvas.clientHeight);
    const distance = this.distance * Math.max(1, (parts > 1 ? 0.8 : 0.85) / wide), eye = plus(this.target, back, distance);
    const view = Float32Array.of(
      right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
      -dot(right, eye), -dot(up, eye), -dot(back, eye), 1,
    );
    const f = 1 / Math.tan(FIELD / 2), near = 0.02 * this.size, far = 30 * this.size;
    const projection = Float32Array.of(
      f / wide, 0, 0, 0, 0, f, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0,
    );
    return { view, projection, eye, right, up, back, f, wide };
  }

  /** Return the ray [eye, direction] through a pixel of the canvas, counted from its corner. */
  ray(x, y) {
    const { eye, right, up, back, f, wide } = this.camera(), { clientWidth, clientHeight } = this.canvas;
    const across = ((2 * x) / clientWidth - 1) * (wide / f), high = (1 - (2 * y) / clientHeight) / f;
    return [eye, unit(plus(plus(scaled(right, across), up, high), back, -1))];
  }

  /** Return the pixel of the canvas at which a point is seen. */
  seen(point) {
    const { eye, right, up, back, f, wide } = this.camera(), way = plus(point, eye, -1), depth = -dot(way, back);
    const { clientWidth, clientHeight } = this.canvas;
    return [(0.5 + (dot(way, right) * f) / (2 * wide * depth)) * clientWidth, (0.5 - (dot(way, up) * f) / (2 * depth)) * clientHeight];
  }

  /** Return the arm's parts as capsules {from, to, radius, joint}, and the tip's frame. */
  parts(tip, q) {
    const frames = jointFrames(this.robot, q), links = [];
    const slim = (k) => this.thick * (1 - 0.45 * Math.min(1, (k + 1) / Math.max(4, this.robot.joints.length)));
    this.robot.joints.forEach((joint, k) => {
      if (joint.coordinate < 0) return;
      const from = joint.parent < 0 ? [0, 0, 0] : frames[joint.parent].origin;
      const start = joint.prismatic ? plus(frames[k].origin, frames[k].axis, -frames[k].value) : frames[k].origin;
      links.push({ from, to: start, radius: slim(k - 1), joint: joint.parent });
      if (joint.prismatic) links.push({ from: start, to: frames[k].origin, radius: slim(k) * 0.6, joint: k });
    });
    const tips = this.robot.tips.map((each) => tipFrame(this.robot, each, frames, this.robot.runtimeTool ? tip.tool : null));
    this.robot.tips.forEach((each, k) => {
      links.push({ from: frames[each.joint].origin, to: tips[k].origin, radius: slim(each.joint) * 0.8, joint: each.joint });
    });
    loopEnds(this.robot, frames).forEach((pair, k) => {
      this.robot.loops.ends[k].forEach(({ joint }, i) => {
        links.push({ from: joint < 0 ? [0, 0, 0] : frames[joint].origin, to: pair[i], radius: slim(joint) * 0.6, joint });
      });
    });
    return { frames, links, tip: tips[this.robot.tips.indexOf(tip.tip)], slim };
  }

  /** Return the solids of a body on a ball joint: two bars of unlike length in the colour of its drive. */
  body({ law, rotation }) {
    const colour = theme()[law], solid = [], middle = this.target;
    const bar = (k, length, radius) => {
      const way = [0, 1, 2].map((i) => rotation[3 * i + k] * length * this.size);
      const [x, y] = beside(unit(way));
      solid.push({ mesh: "drum", model: model(scaled(x, radius), scaled(y, radius), way, middle), colour });
    };
    bar(0, 0.7, 0.9 * this.thick);
    bar(2, 0.4, 0.6 * this.thick);
    const ball = this.thick * 1.3;
    solid.push({ mesh: "sphere", model: model([ball, 0, 0], [0, ball, 0], [0, 0, ball], middle), colour: theme().arm });
    return solid;
  }

  /** Return the solids of the state; with `swing` {law, q}, of an arm that swings under a law, without load and loop. */
  items(swing = null) {
    const state = this.state(), colours = theme(), { tip, ellipsoids } = state;
    const { q, wrench, loop, marker } = swing ? { q: swing.q, wrench: [0, 0, 0, 0, 0, 0], loop: null } : state;
    const { frames, links, tip: hand, slim } = this.parts(tip, q), solid = [], through = [], plain = [];
    const drum = (from, to, radius, colour, mesh = "drum", into = solid) => {
      const way = plus(to, from, -1), long = norm(way);
      if (long < 1e-9) return;
      const [x, y] = beside(scaled(way, 1 / long));
      into.push({ mesh, model: model(scaled(x, radius), scaled(y, radius), way, from), colour });
    };
    const ball = (at, radius, colour, into = solid) =>
      into.push({ mesh: "sphere", model: model([radius, 0, 0], [0, radius, 0], [0, 0, radius], at), colour });
    if (!this.robot.floating) drum([0, 0, 0], [0, 0, 0.25 * this.thick], 2 * this.thick, colours.arm);
    for (const { from, to, radius } of links) {
      drum(from, to, radius, colours.arm);
      ball(from, radius, colours.arm);
      ball(to, radius, colours.arm);
    }
    this.robot.joints.forEach((joint, k) => {
      if (joint.coordinate < 0) return;
      const { origin, axis } = frames[k], colour = rgb(shade(joint.coordinate)), r = slim(k);
      const half = scaled(axis, joint.prismatic ? 0.5 * r : 0.55 * r);
      drum(plus(origin, half, -1), plus(origin, half), joint.prismatic ? r * 1.15 : r * 1.45, colour);
    });
    const solids = this.boxes(state, colours), { goal, boxes } = state;
    if (!swing) for (const each of solids) (each.opacity < 1 ? through : solid).push(each);
    const shadows = solid.map(({ mesh, model: each }) => ({ mesh, model: flattened(each, -0.002 * this.size), colour: colours.shadow, shaded: 0 }));
    const wide = 1.25 * this.size;
    plain.push({ mesh: "grid", model: model([wide, 0, 0], [0, wide, 0], [0, 0, 1], [0, 0, -0.004 * this.size]), colour: colours.floor, shaded: 0 });
    [colours.x, colours.y, colours.z].forEach((colour, k) => {
      const axis = [0, 1, 2].map((i) => (i === k ? 0.22 * this.size : 0));
      drum([0, 0, 0], axis, this.thick * 0.13, colour);
      drum(axis, scaled(axis, 1.15), this.thick * 0.35, colour, "cone");
      const own = [0, 1, 2].map((i) => hand.rotation[3 * i + k] * 0.1 * this.size);
      drum(hand.origin, plus(hand.origin, own), this.thick * 0.12, colour);
    });
    ball(hand.origin, this.thick * 0.5, swing ? colours[swing.law] : colours.ink);
    if (swing) {
      ball(originOf(tip.pose(state.q)), this.thick * 0.35, colours.ink);
      return [...plain, ...shadows, ...solid];
    }
    this.arrows(hand.origin, wrench, colours.ink, drum);
    if (goal) {
      drum(originOf(boxes[0].pose), goal, this.thick * 0.1, colours.ink);
      ball(goal, this.thick * 0.3, colours.ink);
    }
    if (loop) {
      loop.forEach((point, k) => drum(point, loop[(k + 1) % loop.length], this.thick * 0.1, colours.ink));
      drum(hand.origin, marker, this.thick * 0.06, colours.ink);
      ball(marker, this.thick * 0.42, colours.conventional);
    }
    through.push(...this.shells(ellipsoids, hand.origin, colours));
    return [...plain, ...shadows, ...solid, ...through];
  }

  /** Return the solids of matrices' ellipsoids about a point. */
  shells(ellipsoids, at, colours) {
    return ellipsoids.map(({ name, block, length }) => {
      const { values, vectors } = eigen(block, 3);
      const axes = [0, 1, 2].map((k) => {
        const long = Math.min(0.6 * this.size, Math.max(0.004 * this.size, length * Math.abs(values[k])));
        return [0, 1, 2].map((i) => vectors[3 * i + k] * long);
      });
      if (dot(cross(axes[0], axes[1]), axes[2]) < 0) axes[2] = scaled(axes[2], -1);
      return { mesh: "sphere", model: model(...axes, at), colour: colours[name], opacity: 0.45 };
    });
  }

  /** Return the solids of the boxes that the hands hold. */
  boxes({ boxes }, { carton: colour }) {
    return (boxes ?? []).map(({ pose, half, opacity }) => {
      const axes = half.map((long, k) => [0, 1, 2].map((i) => pose[4 * i + k] * long));
      return { mesh: "box", model: model(...axes, originOf(pose)), colour, opacity };
    });
  }

  /** Draw the force as an arrow at the tip and the moment as an arrow with a ring. */
  arrows(at, wrench, colour, drum) {
    const force = wrench.slice(0, 3), moment = wrench.slice(3);
    for (const [vector, length] of [[force, 0.006], [moment, 0.03]]) {
      const strong = norm(vector);
      if (strong < 1e-9) continue;
      const way = scaled(vector, (this.size * Math.min(0.6, 0.12 + length * strong)) / strong), end = plus(at, way), thin = this.thick * 0.12;
      drum(at, end, thin, colour);
      drum(end, plus(end, unit(way), this.thick * 1.1), this.thick * 0.36, colour, "cone");
      if (vector !== moment) continue;
      const [x, y] = beside(unit(way)), middle = plus(at, way, 0.75), r = this.thick * 0.9, sides = 20;
      const rim = (k) => plus(plus(middle, x, r * Math.cos((2 * Math.PI * k) / sides)), y, r * Math.sin((2 * Math.PI * k) / sides));
      for (let k = 0; k < sides - 3; ++k) drum(rim(k), rim(k + 1), thin, colour);
      drum(rim(sides - 3), rim(sides - 1), thin * 2.6, colour, "cone");
    }
  }

  draw() {
    const { arms } = this.state(), parts = arms ? arms.length : 1;
    this.solids.clear();
    for (let k = 0; k < parts; ++k) this.solids.draw(arms?.[k].rotation ? this.body(arms[k]) : this.items(arms?.[k]), this.camera(parts), k, parts);
    this.names.innerHTML = arms ? arms.map(({ law, words }) => `<b class="key ${law}">${words ?? law}</b>`).join("") : "";
    this.letters.forEach((letter, k) => {
      letter.hidden = parts > 1;
      const [x, y] = this.seen([0, 1, 2].map((i) => (i === k ? 0.3 * this.size : 0)));
      letter.style.left = `${x}px`;
      letter.style.top = `${y}px`;
    });
  }

  place(event) {
    const { left, top } = this.canvas.getBoundingClientRect();
    return [event.clientX - left, event.clientY - top];
  }

  pressed(event) {
    this.canvas.setPointerCapture(event.pointerId);
    const place = this.place(event);
    this.pointers.set(event.pointerId, place);
    this.drag = this.pointers.size === 1 ? this.grabbed(...place, event.pointerType === "touch" ? 1.8 : 1) : null;
  }

  /** Return the object under a pixel of the canvas: the loop's bead, the tip, a link, or null. */
  grabbed(x, y, ease) {
    const { tip, q, loop, marker, boxes } = this.state(), [eye, way] = this.ray(x, y), { frames, links, tip: hand } = this.parts(tip, q);
    const near = (point, radius) => rayToSegment(eye, way, point, point).distance < radius * ease;
    const depth = (point) => dot(plus(point, eye, -1), way);
    if (boxes) return this.grabbedBox(boxes, eye, way, ease);
    if (loop && near(marker, this.thick * 0.8)) return { kind: "bead" };
    if (near(hand.origin, this.thick * 1.3)) return { kind: "tip", depth: depth(hand.origin), offset: plus(hand.origin, plus(eye, way, depth(hand.origin)), -1), orientation: rotationOf(tip.pose(q)) };
    let best = null;
    for (const { from, to, radius, joint } of links) {
      const found = rayToSegment(eye, way, from, to);
      if (joint >= 0 && found.distance < radius * 1.2 * ease && !(best && best.depth < found.depth)) best = { kind: "link", joint, depth: found.depth };
    }
    if (!best) return null;
    const point = plus(plus(eye, way, best.depth), frames[best.joint].origin, -1), R = frames[best.joint].rotation;
    return { ...best, local: multiply(transpose(R, 3, 3), point, 3, 3, 1) };
  }

  /** Return the held box where a ray meets it, or null: on a lap there are two, which nobody drags. */
  grabbedBox([{ pose, half }, another], eye, way, ease) {
    const middle = originOf(pose), along = [0, 1, 2].map((i) => pose[4 * i] * half[0]);
    const { distance } = rayToSegment(eye, way, plus(middle, along, -1), plus(middle, along)), depth = dot(plus(middle, eye, -1), way);
    if (another || distance > half[1] * 1.2 * ease) return null;
    return { kind: "box", depth, offset: plus(this.state().goal, plus(eye, way, depth), -1) };
  }

  dragged(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const place = this.place(event), [dx, dy] = plus(place, before, -1);
    this.pointers.set(event.pointerId, place);
    if (this.pointers.size === 2) {
      const [a, b] = [...this.pointers.values()], other = a === place ? b : a;
      this.zoom(norm(plus(before, other, -1)) / Math.max(1, norm(plus(place, other, -1))));
    } else if (!this.drag) {
      this.look(dx * 0.008, dy * 0.008);
    } else if (this.drag.kind === "bead") {
      this.carryBead(place);
    } else {
      const { tip, q } = this.state(), [eye, way] = this.ray(...place), goal = plus(eye, way, this.drag.depth);
      if (this.drag.kind === "box") this.boxed(plus(goal, this.drag.offset));
      else if (this.drag.kind === "tip") this.moved(follow(tip, q, plus(goal, this.drag.offset), this.drag.orientation));
      else this.moved(this.pulled(tip, q, goal));
    }
  }

  /** Move the joints so that the grabbed point of a link comes to a place. */
  pulled(tip, q, goal) {
    for (let round = 0; round < 4; ++round) {
      const frames = jointFrames(this.robot, q), point = placed(frames[this.drag.joint], this.drag.local);
      const J = pointJacobian(this.robot, frames, this.drag.joint, point), off = plus(goal, point, -1);
      const way = Float64Array.from(scaled(off, Math.min(1, (0.1 * this.size) / (norm(off) || 1))));
      q = guardedStep(tip, q, tip.stepTowards(q, J, way, 0.05 * this.size), (at) => {
        const moved = jointFrames(this.robot, at);
        return tip.ofMotors(at, pointJacobian(this.robot, moved, this.drag.joint, placed(moved[this.drag.joint], this.drag.local)));
      });
    }
    return q;
  }

  carryBead(place) {
    const { loop, lap } = this.state();
    let best = 0, least = Infinity;
    loop.forEach((point, k) => {
      const distance = norm(plus(this.seen(point), place, -1));
      if (distance < least) [best, least] = [k, distance];
    });
    const part = best / loop.length - (lap - Math.floor(lap));
    this.carried(part - Math.round(part));
  }

  released(event) {
    this.pointers.delete(event.pointerId);
    this.drag = null;
  }

  key(event) {
    const ways = { ArrowLeft: [-1, 0, 0], ArrowRight: [1, 0, 0], ArrowUp: [0, 1, 0], ArrowDown: [0, -1, 0], PageUp: [0, 0, 1], PageDown: [0, 0, -1] };
    const way = ways[event.key];
    if (event.shiftKey && way) {
      const { tip, q, goal } = this.state(), pose = tip.pose(q);
      if (goal) this.boxed(plus(goal, way, 0.01 * this.size));
      else this.moved(follow(tip, q, plus(originOf(pose), way, 0.01 * this.size), rotationOf(pose)));
    } else if (way && !way[2]) {
      this.look(0.12 * way[0], 0.12 * way[1]);
    } else if (event.key === "+" || event.key === "-") {
      this.zoom(event.key === "+" ? 0.9 : 1.1);
    } else if (event.key === "Home") {
      this.home();
    } else return;
    event.preventDefault();
  }
}
