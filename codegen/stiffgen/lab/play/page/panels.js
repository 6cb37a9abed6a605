// SPDX-License-Identifier: MIT
// Controls: a row with a name, a slider, the same value as a number, and a unit; names that fit there.

let count = 0;

/**
 * A slider in `parent`. `label` is its name (`shown`: as HTML), with `unit`; it runs from `min` to `max` in steps of `step`.
 * A value beyond the ends is clamped, and a note below says so; `limited`: also where the value is at an end.
 * `changed(value)` is called while it moves. Gives {set(value)}, which calls nothing.
 */
export function slider(parent, { label, shown = label, unit, min, max, step, value, colour, limited = false, changed }) {
  const row = document.createElement("div"), id = `s${++count}`, digits = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
  row.className = "slider";
  row.innerHTML =
    `<label for="${id}">${colour ? `<span class="swatch" style="--swatch:${colour}"></span>` : ""}${shown}</label>` +
    `<input type="range" id="${id}"><input type="number"><span class="unit">${unit}</span><output class="note" hidden></output>`;
  const [range, box] = row.querySelectorAll("input");
  row.querySelector("label").title = label;
  range.setAttribute("aria-label", `${label} in ${unit}`);
  box.setAttribute("aria-label", `${label} in ${unit}, as a number`);
  for (const input of [range, box]) Object.assign(input, { min, max, step });
  box.step = "any";
  const note = row.querySelector(".note");
  const say = (asked, kept) => {
    const beyond = Math.abs(asked - kept) > 1e-9 * (1 + Math.abs(kept));
    note.hidden = !beyond && !atLimit(kept);
    note.textContent = beyond
      ? `${Number(asked.toFixed(digits + 1))} is beyond the end: ${kept.toFixed(digits)} ${unit} is taken.`
      : `At its limit, ${kept.toFixed(digits)} ${unit}.`;
  };
  const atLimit = (value) => limited && (value <= min + 1e-6 || value >= max - 1e-6);
  const set = (to) => {
    say(Number(to), Math.min(Math.max(Number(to), min), max));
    range.value = to;
    box.value = Number(to).toFixed(digits);
    range.setAttribute("aria-valuetext", `${box.value} ${unit}`);
  };
  const take = (input) => () => {
    const given = Number(input.value);
    if (input.value === "" || !Number.isFinite(given)) return;
    const inside = Math.min(Math.max(given, min), max);
    if (input === box) range.value = inside;
    else box.value = inside.toFixed(digits);
    range.setAttribute("aria-valuetext", `${inside.toFixed(digits)} ${unit}`);
    say(given, inside);
    changed(inside);
  };
  range.addEventListener("input", take(range));
  box.addEventListener("input", take(box));
  box.addEventListener("change", () => (box.value = Number(range.value).toFixed(digits)));
  parent.append(row);
  set(value);
  return { set };
}

/**
 * Let something move on to a time [s], and append its numbers to curves each `every` seconds. `moving` has a time and
 * advance(until); values() gives a number for each of the curves, which are equally long.
 */
export function record(moving, until, every, curves, values) {
  const ahead = () => Object.values(curves)[0].length * every;
  while (moving.time < until - 1e-9) {
    moving.advance(Math.min(until, ahead()));
    if (moving.time < ahead() - 1e-9) break;
    for (const [name, value] of Object.entries(values())) curves[name].push(value);
  }
}

/** Choices of a select element: [value, text] pairs. */
export function options(select, pairs) {
  select.replaceChildren(...pairs.map(([value, text]) => new Option(text, value)));
}

/** Return names without the words that all of them begin or end with: of panda_joint1, panda_joint2 the second word. */
export function distinct(names) {
  const words = names.map((name) => name.split(/[_\-/. ]+/)), fewest = Math.min(...words.map(({ length }) => length));
  const shared = (at) => {
    let count = 0;
    while (count < fewest - 1 && words.every((each) => each.at(at(count)) === words[0].at(at(count)))) count++;
    return count;
  };
  const first = shared((k) => k), last = Math.min(shared((k) => -1 - k), fewest - 1 - first);
  return names.length < 2 ? names : words.map((each) => each.slice(first, each.length - last).join("_"));
}
