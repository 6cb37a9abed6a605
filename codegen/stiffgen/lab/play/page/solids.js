// SPDX-License-Identifier: MIT
// Solids drawn by WebGL: spheres, drums, cones and boxes, each with a pose, a colour and an opacity.

const VERTEX = `#version 300 es
in vec3 position; in vec3 normal;
uniform mat4 model, view, projection;
out vec3 facing, place;
void main() {
  vec4 here = model * vec4(position, 1.0);
  place = here.xyz;
  facing = transpose(inverse(mat3(model))) * normal;
  gl_Position = projection * view * here;
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 facing, place;
uniform vec3 colour, eye;
uniform float opacity, shaded;
out vec4 result;
void main() {
  vec3 n = normalize(facing), to = normalize(eye - place);
  if (dot(n, to) < 0.0) n = -n;
  vec3 light = normalize(to + vec3(0.3, -0.2, 0.9));
  float shade = 0.42 + 0.48 * max(dot(n, light), 0.0) + 0.12 * n.z;
  float gloss = 0.25 * pow(max(dot(reflect(-light, n), to), 0.0), 24.0);
  float rim = mix(1.0, 1.0 + 1.2 * pow(1.0 - abs(dot(n, to)), 2.0), step(opacity, 0.99));
  result = vec4(mix(colour, colour * shade + gloss, shaded), opacity * rim);
}`;
const ROUND = 40; // sides of a drum

function sphere() {
  const points = [], triangles = [], rows = 20;
  for (let i = 0; i <= rows; ++i) {
    for (let j = 0; j <= ROUND; ++j) {
      const a = (Math.PI * i) / rows, b = (2 * Math.PI * j) / ROUND;
      const p = [Math.sin(a) * Math.cos(b), Math.sin(a) * Math.sin(b), Math.cos(a)];
      points.push(...p, ...p);
      const k = i * (ROUND + 1) + j;
      if (i < rows && j < ROUND) triangles.push(k, k + ROUND + 1, k + 1, k + 1, k + ROUND + 1, k + ROUND + 2);
    }
  }
  return { points, triangles };
}

/** Make a solid about z from 0 to 1, with radius 1 below and `top` above, closed at both ends. */
function drum(top) {
  const points = [], triangles = [], lean = 1 - top;
  const corner = (p, n) => points.push(...p, ...n) / 6 - 1;
  const rim = (k, r, z, n) => corner([r * Math.cos(k), r * Math.sin(k), z], n ?? [Math.cos(k), Math.sin(k), lean]);
  for (let j = 0; j < ROUND; ++j) {
    const a = (2 * Math.PI * j) / ROUND, b = (2 * Math.PI * (j + 1)) / ROUND;
    const [p, q, r, s] = [rim(a, 1, 0), rim(b, 1, 0), rim(a, top, 1), rim(b, top, 1)];
    triangles.push(p, q, r, q, s, r);
    for (const [radius, z] of [[1, 0], [top, 1]]) {
      const n = [0, 0, 2 * z - 1];
      if (radius) triangles.push(corner([0, 0, z], n), rim(a, radius, z, n), rim(b, radius, z, n));
    }
  }
  return { points, triangles };
}

/** Make a grid of lines from -1 to 1 in x and y at z = 0. */
function grid() {
  const points = [], triangles = [];
  for (let k = -8; k <= 8; ++k) {
    for (const p of [[k / 8, -1], [k / 8, 1], [-1, k / 8], [1, k / 8]]) {
      triangles.push(points.push(...p, 0, 0, 0, 1) / 6 - 1);
    }
  }
  return { points, triangles };
}

/** Make a box from -1 to 1 along each axis. */
function box() {
  const points = [], triangles = [];
  for (let k = 0; k < 6; ++k) {
    const axis = k >> 1, sign = 2 * (k % 2) - 1, [u, v] = [(axis + 1) % 3, (axis + 2) % 3];
    const corners = [[-1, -1], [sign, -sign], [1, 1], [-sign, sign]].map(([a, b]) => {
      const p = [0, 0, 0], n = [0, 0, 0];
      [p[axis], p[u], p[v], n[axis]] = [sign, a, b, sign];
      return points.push(...p, ...n) / 6 - 1;
    });
    triangles.push(...[0, 1, 2, 0, 2, 3].map((i) => corners[i]));
  }
  return { points, triangles };
}

const MESHES = { sphere: sphere(), drum: drum(1), cone: drum(0), grid: grid(), box: box() };

/** Canvas with solids. The constructor throws where the browser has no WebGL. */
export class Solids {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: false });
    if (!this.gl) throw new Error("no WebGL");
    this.start();
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.start());
  }

  start() {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.bindAttribLocation(program, 0, "position");
    gl.bindAttribLocation(program, 1, "normal");
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`no WebGL program: ${gl.getProgramInfoLog(program)}`);
    }
    gl.useProgram(program);
    this.at = Object.fromEntries(
      ["model", "view", "projection", "colour", "eye", "opacity", "shaded"].map((name) => [
        name,
        gl.getUniformLocation(program, name),
      ]),
    );
    this.meshes = {};
    for (const [name, { points, triangles }] of Object.entries(MESHES)) {
      const vertices = gl.createVertexArray();
      gl.bindVertexArray(vertices);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, Float32Array.from(points), gl.STATIC_DRAW);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, Uint16Array.from(triangles), gl.STATIC_DRAW);
      for (const k of [0, 1]) {
        gl.enableVertexAttribArray(k);
        gl.vertexAttribPointer(k, 3, gl.FLOAT, false, 24, 12 * k);
      }
      this.meshes[name] = { vertices, count: triangles.length };
    }
    gl.enable(gl.DEPTH_TEST);
    gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
  }

  /** Clear the canvas, and fit it to its place on the page. */
  clear() {
    const { gl, canvas } = this, sharp = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.round(canvas.clientWidth * sharp), height = Math.round(canvas.clientHeight * sharp);
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  /**
   * Draw items {mesh, model (16, column-major), colour (3), opacity, shaded}; transparent ones come last.
   * `part` of `parts` columns of the canvas, from the left.
   */
  draw(items, camera, part = 0, parts = 1) {
    const { gl, canvas, at } = this;
    gl.viewport(Math.round((canvas.width * part) / parts), 0, Math.round(canvas.width / parts), canvas.height);
    gl.uniformMatrix4fv(at.view, false, camera.view);
    gl.uniformMatrix4fv(at.projection, false, camera.projection);
    gl.uniform3fv(at.eye, camera.eye);
    for (const { mesh, model, colour, opacity = 1, shaded = 1 } of items) {
      const through = opacity < 1;
      (through ? gl.enable : gl.disable).call(gl, gl.BLEND);
      (through ? gl.enable : gl.disable).call(gl, gl.CULL_FACE);
      gl.depthMask(!through);
      gl.uniformMatrix4fv(at.model, false, model);
      gl.uniform3fv(at.colour, colour);
      gl.uniform1f(at.opacity, opacity);
      gl.uniform1f(at.shaded, shaded);
      gl.bindVertexArray(this.meshes[mesh].vertices);
      gl.drawElements(mesh === "grid" ? gl.LINES : gl.TRIANGLES, this.meshes[mesh].count, gl.UNSIGNED_SHORT, 0);
    }
    gl.depthMask(true);
  }
}

/** Return a model matrix with the columns x, y, z and origin. */
export const model = (x, y, z, origin) => Float32Array.of(...x, 0, ...y, 0, ...z, 0, ...origin, 1);

/** Project a model matrix onto the floor, as a shadow of light from above. */
export function flattened(matrix, floor) {
  const flat = matrix.slice();
  for (const k of [2, 6, 10]) flat[k] *= 1e-4;
  flat[14] = floor;
  return flat;
}
