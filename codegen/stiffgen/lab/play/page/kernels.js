// SPDX-License-Identifier: MIT
// The generated C, compiled to WebAssembly: functions by name, arrays in the module's memory.

const LIBM = {
  fmin: (a, b) => (Number.isNaN(a) ? b : Number.isNaN(b) ? a : Math.min(a, b)),
  fmax: (a, b) => (Number.isNaN(a) ? b : Number.isNaN(b) ? a : Math.max(a, b)),
};
const LINE = 64; // bytes between arrays

/**
 * Start the module.
 *
 * bytes: the module. functions: name -> {arguments, results}, each a list of [name, shape]. selfCheck: the name of the
 * function that says whether this engine computes what the kernels promise.
 *
 * Gives {call}: call(name, given) with `given` arrays by argument name returns the first result as a new Float64Array,
 * row after row. Throws where an argument is missing or has another size.
 */
export async function startKernels(bytes, functions, selfCheck) {
  const module = await WebAssembly.compile(bytes);
  const env = Object.fromEntries(
    WebAssembly.Module.imports(module).map(({ name }) => [name, LIBM[name] ?? Math[name.replace("fabs", "abs")]]),
  );
  const { exports } = await WebAssembly.instantiate(module, { env });
  if (exports[selfCheck]() !== 0) throw new Error("This browser's arithmetic is not what the kernels need.");
  let end = Math.ceil(exports.__heap_base.value / LINE) * LINE;
  const size = (shape) => shape.reduce((product, extent) => product * extent, 1);
  const placed = ([name, shape]) => {
    const at = end, count = size(shape);
    end += Math.ceil((8 * count) / LINE) * LINE;
    return { name, at, count };
  };
  const places = Object.fromEntries(
    Object.entries(functions).map(([name, arrays]) => [
      name,
      { given: arrays.arguments.map(placed), results: arrays.results.map(placed) },
    ]),
  );
  const missing = end - exports.memory.buffer.byteLength;
  if (missing > 0) exports.memory.grow(Math.ceil(missing / 65536));
  const memory = new Float64Array(exports.memory.buffer);

  function call(name, given) {
    const place = places[name];
    for (const { name: argument, at, count } of place.given) {
      if (given[argument]?.length !== count) throw new Error(`${name} takes ${count} numbers as ${argument}`);
      memory.set(given[argument], at / 8);
    }
    exports[name](...place.given.map(({ at }) => at), ...place.results.map(({ at }) => at));
    const { at, count } = place.results[0];
    return memory.slice(at / 8, at / 8 + count);
  }

  return { call };
}
