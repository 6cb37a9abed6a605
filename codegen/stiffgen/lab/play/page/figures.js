// SPDX-License-Identifier: MIT
// Figures on flat canvases: heat maps of matrices, and the work over the laps.

import { largest } from "./algebra.js";

/** Return the page's colours by name, as [r, g, b] from 0 to 1; they follow the system's dark mode. */
export function theme() {
  const style = getComputedStyle(document.documentElement);
  const parsed = (name) => {
    const number = parseInt(style.getPropertyValue(`--${name}`).trim().slice(1), 16);
    return [16, 8, 0].map((shift) => ((number >> shift) & 255) / 255);
  };
  const names = [
    "page", "ink", "panel", "line", "soft", "corrected", "conventional", "exact", "secant", "negative", "translation",
    "rotation", "x", "y", "z", "arm", "floor", "shadow", "carton",
  ];
  return Object.fromEntries(names.map((name) => [name, parsed(name)]));
}

/** Names of the joints' colours. */
export const SHADES = ["#b35fc9", "#c9a227", "#6f8fa3", "#d6456b", "#4fb0a5", "#8a7ff0", "#9a6b4f"];
export const shade = (k) => SHADES[k % SHADES.length];

const css = (colour) => `rgb(${colour.map((c) => Math.round(255 * c)).join(" ")})`;
const mixed = (a, b, part) => a.map((x, k) => x + (b[k] - x) * part);

function luminance(colour) {
  const [r, g, b] = colour.map((c) => (c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4));
  return 0.2126 * r + 0.7152 * g + 0.0722 * b;
}

/** Format a number with three digits and a true minus sign. */
export function number(value, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  const text = size >= 1e-3 && size < 1e5 ? value.toFixed(Math.max(0, digits - 1 - Math.floor(Math.log10(size)))) : value.toExponential(1);
  return text.replace(/^-/, "−").replace("e-", "e−").replace("e+", "e");
}

function prepared(canvas) {
  const sharp = Math.min(window.devicePixelRatio || 1, 2), { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * sharp)) canvas.width = Math.round(width * sharp);
  if (canvas.height !== Math.round(height * sharp)) canvas.height = Math.round(height * sharp);
  const pen = canvas.getContext("2d");
  pen.setTransform(sharp, 0, 0, sharp, 0, 0);
  pen.clearRect(0, 0, width, height);
  return { pen, width, height };
}

/** Draw a matrix (n x n) as a square of cells, shaded by the square root of value / `most`; null draws none. */
export function drawMatrix(canvas, matrix, { n, most, colours, cursor, labels }) {
  const { pen, width } = prepared(canvas), edge = 22, size = (width - edge) / n;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  pen.font = "11px system-ui, sans-serif";
  labels.forEach(({ text, colour }, k) => {
    const at = edge + (k + 0.5) * size;
    for (const [x, y] of [[at, edge / 2], [edge / 2, at]]) {
      pen.fillStyle = colour;
      pen.fillRect(x === at ? at - size / 2 + 1 : edge - 4, x === at ? edge - 4 : at - size / 2 + 1, x === at ? size - 2 : 3, x === at ? 3 : size - 2);
      pen.fillStyle = css(colours.ink);
      if (size > 13) pen.fillText(text, x === at ? x : x - 2, x === at ? y - 3 : y);
    }
  });
  if (!matrix) {
    pen.fillStyle = css(colours.soft);
    pen.fillText("no spring holds this wrench", edge + (n * size) / 2, edge + (n * size) / 2);
    return;
  }
  pen.font = `${Math.min(12, size / 3.4)}px system-ui, sans-serif`;
  for (let i = 0; i < n; ++i) {
    for (let j = 0; j < n; ++j) {
      const value = matrix[i * n + j], part = most > 0 ? Math.min(1, Math.sqrt(Math.abs(value) / most)) : 0;
      const colour = mixed(colours.page, value < 0 ? colours.negative : colours.ink, 0.85 * part);
      pen.fillStyle = css(colour);
      pen.fillRect(edge + j * size + 0.5, edge + i * size + 0.5, size - 1, size - 1);
      if (size >= 26) {
        pen.fillStyle = luminance(colour) > 0.18 ? "#000" : "#fff";
        pen.fillText(Math.abs(value) < 1e-9 * most ? "0" : number(value, Math.abs(value) >= 100 ? 3 : 2), edge + (j + 0.5) * size, edge + (i + 0.5) * size + 0.5);
      }
    }
  }
  if (cursor) {
    pen.strokeStyle = css(colours.ink);
    pen.lineWidth = 2.5;
    pen.strokeRect(edge + cursor[1] * size + 1, edge + cursor[0] * size + 1, size - 2, size - 2);
  }
}

/** Return the cell [i, j] under a point of a matrix's canvas, or null. */
export function cellAt(canvas, x, y, n) {
  const edge = 22, size = (canvas.clientWidth - edge) / n, cell = [Math.floor((y - edge) / size), Math.floor((x - edge) / size)];
  return cell.every((k) => k >= 0 && k < n) ? cell : null;
}

const DASHES = { conventional: [], corrected: [], secant: [2, 3], exact: [8, 6] };
const WIDTHS = { conventional: 2, corrected: 4, secant: 2, exact: 2 };
export const LAPS = 3; // that are drawn and gone

/** Draw the work over LAPS laps from works[law] of one lap, with a line at the arm's place, `laps`. */
export function drawWork(canvas, works, laps, colours) {
  const { pen, width, height } = prepared(canvas), left = 52, right = width - 8, top = 8, bottom = height - 30;
  const net = (law) => works[law].at(-1);
  const ends = Object.keys(works).flatMap((law) => [...works[law], ...works[law].map((w) => w + (LAPS - 1) * net(law))]);
  const most = Math.max(1e-6, ...ends), least = Math.min(-1e-6, ...ends), room = 0.06 * (most - least);
  const x = (lap) => left + ((right - left) * lap) / LAPS;
  const y = (work) => bottom - ((work - least + room) / (most - least + 2 * room)) * (bottom - top);
  frame(pen, { left, right, top, bottom, least, most, y, label: "work put out [J]", colours });
  for (let lap = 0; lap <= LAPS; ++lap) pen.fillText(lap, Math.min(x(lap), right - 3), bottom + 9);
  pen.fillText("laps", (left + right) / 2, bottom + 22);
  for (const law of ["corrected", "conventional", "secant", "exact"].filter((each) => works[each])) {
    pen.strokeStyle = css(colours[law]);
    pen.setLineDash(DASHES[law]);
    pen.lineWidth = WIDTHS[law];
    const once = works[law], count = once.length - 1, points = [];
    for (let k = 0; k <= LAPS * count; ++k) {
      points.push([x(k / count), y(once[k === LAPS * count ? count : k % count] + (k === LAPS * count ? LAPS - 1 : Math.floor(k / count)) * net(law))]);
    }
    line(pen, points);
  }
  pen.setLineDash([]);
  pen.lineWidth = 1.5;
  pen.strokeStyle = css(colours.ink);
  line(pen, [[x(laps), top], [x(laps), bottom]]);
}

/** Draw curves [[law, values]] over time, a value every `every` seconds, up to `seconds`; 0 is always in the picture. */
export function drawCurves(canvas, curves, every, seconds, label, colours) {
  const { pen, width, height } = prepared(canvas), left = 52, right = width - 8, top = 8, bottom = height - 30;
  const ends = curves.flatMap(([, values]) => values), most = Math.max(ends.length ? 1e-3 : 1, ...ends), least = Math.min(0, ...ends);
  const room = 0.06 * (most - least), x = (time) => left + ((right - left) * time) / seconds;
  const y = (value) => bottom - ((value - least + room) / (most - least + 2 * room)) * (bottom - top);
  frame(pen, { left, right, top, bottom, least, most, y, label, colours });
  for (let second = 0; second <= seconds; ++second) pen.fillText(second, Math.min(x(second), right - 3), bottom + 9);
  pen.fillText("time [s]", (left + right) / 2, bottom + 22);
  for (const [law, values] of curves) {
    pen.strokeStyle = css(colours[law]);
    pen.setLineDash(DASHES[law]);
    pen.lineWidth = WIDTHS[law];
    line(pen, values.map((value, k) => [x(k * every), y(value)]));
  }
  pen.setLineDash([]);
}

/** Draw the horizontal lines with their numbers, and the label beside them; leave the pen centred for numbers below. */
function frame(pen, { left, right, top, bottom, least, most, y, label, colours }) {
  pen.font = "11px system-ui, sans-serif";
  pen.lineWidth = 1;
  pen.strokeStyle = css(colours.line);
  pen.fillStyle = css(colours.ink);
  pen.textBaseline = "middle";
  pen.textAlign = "right";
  const step = niceStep((most - least) / 4);
  for (let k = Math.ceil(least / step); k * step <= most; ++k) {
    pen.globalAlpha = k === 0 ? 1 : 0.3;
    line(pen, [[left, y(k * step)], [right, y(k * step)]]);
    pen.globalAlpha = 1;
    pen.fillText(number(k * step, 2), left - 5, y(k * step));
  }
  pen.textAlign = "center";
  pen.save();
  pen.translate(9, (top + bottom) / 2);
  pen.rotate(-Math.PI / 2);
  pen.fillText(label, 0, 0);
  pen.restore();
}

function line(pen, points) {
  pen.beginPath();
  for (const [x, y] of points) pen.lineTo(x, y);
  pen.stroke();
}

function niceStep(about) {
  const power = 10 ** Math.floor(Math.log10(about));
  return power * [1, 2, 5, 10].find((k) => k * power >= about);
}

/** Return the work that a law has done after `laps` laps. */
export function workAt(once, laps) {
  const count = once.length - 1, whole = Math.floor(laps), at = (laps - whole) * count, k = Math.floor(at);
  const part = k < count ? once[k] + (at - k) * (once[k + 1] - once[k]) : once[count];
  return whole * once[count] + part;
}

/** Return the scale of the three stiffnesses and of the antisymmetric part, which is at least a hundredth. */
export function scales(matrices) {
  const most = Math.max(...["conventional", "corrected", "exact"].map((name) => (matrices[name] ? largest(matrices[name]) : 0)));
  return { most, antisymmetric: Math.max(largest(matrices.antisymmetric), most / 100) };
}
