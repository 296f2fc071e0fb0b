// A small WebGL renderer: one mesh per model, coloured by its error, and the measured points.
// Without WebGL the same points are drawn on a plain canvas.

const STOPS = [[59, 111, 182], [127, 179, 168], [240, 199, 94], [209, 73, 91]];
const VERTEX = `
attribute vec3 place; attribute vec3 normal; attribute vec3 colour;
uniform mat4 view; uniform mat3 turn; uniform float size; uniform float lit;
varying vec3 shade;
void main() {
  gl_Position = view * vec4(place, 1.0);
  gl_PointSize = size;
  float light = 0.55 + 0.45 * abs((turn * normal).z);
  shade = colour * mix(1.0, light, lit);
}`;
const FRAGMENT = `
precision mediump float;
varying vec3 shade; uniform float alpha; uniform float round;
void main() {
  if (round > 0.5 && length(gl_PointCoord - 0.5) > 0.5) discard;
  gl_FragColor = vec4(shade, alpha);
}`;

/** Return the colour of an error, [r, g, b] from 0 to 1; `most` is the end of the scale. */
export function colourOf(error, most) {
  const at = Math.min(Math.max(error / most, 0), 1) * (STOPS.length - 1), k = Math.min(Math.floor(at), STOPS.length - 2);
  return STOPS[k].map((low, i) => (low + (at - k) * (STOPS[k + 1][i] - low)) / 255);
}

const SAME = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];

/** Return the rotation that takes gravity to -z by the shortest way. A robot that `hangs` is first turned over about x, so that
 *  no turn is near 180 degrees, where its axis would jump. */
export function levelled([x, y, z], hangs) {
  const over = hangs ? -1 : 1, [a, b, c] = [x, over * y, over * z], w = 1 - c;
  if (w < 1e-9) return [[1, 0, 0], [0, -over, 0], [0, 0, -over]];
  const turn = [[1 - a * a / w, -a * b / w, a], [-a * b / w, 1 - b * b / w, b], [-a, -b, -c]];
  return turn.map(([p, q, r]) => [p, over * q, over * r]);
}

export class Scene {
  constructor(canvas) {
    this.canvas = canvas;
    this.yaw = 0.6; this.pitch = -0.25; this.zoom = 1;
    this.layers = [];
    this.level = SAME;
    this.triangles = new Uint16Array(0);
    this.centre = [0, 0, 0]; this.radius = 50;
    this.gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
    if (this.gl) this.prepare(); else this.plain = canvas.getContext("2d");
    this.listen();
  }

  prepare() {
    const gl = this.gl, program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
    this.at = name => gl.getUniformLocation(program, name);
    this.slots = ["place", "normal", "colour"].map(name => {
      const slot = gl.getAttribLocation(program, name), buffer = gl.createBuffer();
      gl.enableVertexAttribArray(slot);
      return { slot, buffer };
    });
    this.elements = gl.createBuffer();
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    this.canvas.addEventListener("webglcontextlost", event => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => { this.prepare(); this.draw(); });
  }

  /** Set the template that all shapes share, and the room that they take. */
  setBody(triangles, rest) {
    this.triangles = rest.length / 3 > 65535 ? new Uint16Array(0) : Uint16Array.from(triangles);  // then points
    const low = [1e9, 1e9, 1e9], high = [-1e9, -1e9, -1e9];
    for (let i = 0; i < rest.length; i++) { low[i % 3] = Math.min(low[i % 3], rest[i]); high[i % 3] = Math.max(high[i % 3], rest[i]); }
    this.centre = low.map((x, i) => (x + high[i]) / 2);
    this.radius = 0.62 * Math.hypot(...high.map((x, i) => x - low[i])) || 1;
  }

  /** Draw along gravity: `down` is its unit vector now, `usual` its mean over the run. Without it z is up. */
  setDown(down, usual) { this.level = down ? levelled(down, usual[2] > 0) : SAME; }

  /** Set the layers: {points, colours (3N), mesh (bool), alpha, size}. */
  setLayers(layers) { this.layers = layers; this.draw(); }

  listen() {
    const canvas = this.canvas, held = new Map();
    let apart = 0;
    canvas.addEventListener("pointerdown", event => { canvas.setPointerCapture(event.pointerId); held.set(event.pointerId, [event.clientX, event.clientY]); });
    canvas.addEventListener("pointermove", event => {
      const before = held.get(event.pointerId);
      if (!before) return;
      held.set(event.pointerId, [event.clientX, event.clientY]);
      if (held.size === 2) {
        const [a, b] = [...held.values()], now = Math.hypot(a[0] - b[0], a[1] - b[1]);
        if (apart) this.scale(now / apart);
        apart = now;
      } else this.rotate((event.clientX - before[0]) * 0.01, (event.clientY - before[1]) * 0.01);
    });
    for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, event => { held.delete(event.pointerId); apart = 0; });
    canvas.addEventListener("wheel", event => { event.preventDefault(); this.scale(Math.exp(-event.deltaY * 0.001)); }, { passive: false });
    canvas.addEventListener("keydown", event => {
      const turn = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, -0.1], ArrowDown: [0, 0.1] }[event.key];
      if (turn) this.rotate(...turn);
      else if (event.key === "+" || event.key === "=") this.scale(1.1);
      else if (event.key === "-") this.scale(1 / 1.1);
      else return;
      event.preventDefault();
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  rotate(x, y) { this.yaw += x; this.pitch = Math.min(1.5, Math.max(-1.5, this.pitch + y)); this.draw(); }
  scale(by) { this.zoom = Math.min(8, Math.max(0.3, this.zoom * by)); this.draw(); }

  /** Rows of the rotation: right, up, towards the viewer. Gravity points down, or the finger's z axis up. */
  axes() {
    const [cy, sy, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    const view = [[cy, -sy, 0], [-sp * sy, -sp * cy, cp], [-cp * sy, -cp * cy, -sp]];
    return view.map(row => [0, 1, 2].map(k => row.reduce((sum, x, i) => sum + x * this.level[i][k], 0)));
  }

  draw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.paint(); });
  }

  paint() {
    const canvas = this.canvas, ratio = Math.min(devicePixelRatio || 1, 2);
    const w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (!w || !h) return;
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const axes = this.axes(), scale = this.zoom * Math.min(w, h) / (2 * this.radius);
    if (!this.gl) { this.paintPlain(axes, scale, w, h); return; }
    const gl = this.gl, c = this.centre, view = new Float32Array(16), factor = [2 * scale / w, 2 * scale / h, -0.2 / this.radius];
    for (let row = 0; row < 3; row++) {
      for (let k = 0; k < 3; k++) view[4 * k + row] = axes[row][k] * factor[row];
      view[12 + row] = -factor[row] * axes[row].reduce((sum, x, k) => sum + x * c[k], 0);
    }
    view[15] = 1;
    gl.viewport(0, 0, w, h);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(this.at("view"), false, view);
    gl.uniformMatrix3fv(this.at("turn"), false, new Float32Array([0, 1, 2].flatMap(k => axes.map(row => row[k]))));
    for (const layer of this.layers) {
      const mesh = layer.mesh && this.triangles.length > 0;
      this.fill(0, layer.points);
      this.fill(1, mesh ? normals(layer.points, this.triangles) : new Float32Array(layer.points.length));
      this.fill(2, layer.colours);
      gl.uniform1f(this.at("alpha"), layer.alpha);
      gl.uniform1f(this.at("lit"), mesh ? 1 : 0);
      gl.uniform1f(this.at("round"), mesh ? 0 : 1);
      gl.uniform1f(this.at("size"), (layer.size || 4) * ratio);
      gl.depthMask(layer.alpha > 0.9);
      if (mesh) {
        gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, this.elements);
        gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, this.triangles, gl.STATIC_DRAW);
        gl.drawElements(gl.TRIANGLES, this.triangles.length, gl.UNSIGNED_SHORT, 0);
      } else gl.drawArrays(gl.POINTS, 0, layer.points.length / 3);
    }
    gl.depthMask(true);
  }

  fill(k, data) {
    const gl = this.gl, { slot, buffer } = this.slots[k];
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
    gl.vertexAttribPointer(slot, 3, gl.FLOAT, false, 0, 0);
  }

  paintPlain(axes, scale, w, h) {
    const c = this.plain, m = this.centre;
    c.clearRect(0, 0, w, h);
    for (const layer of this.layers) {
      for (let i = 0; i < layer.points.length; i += 3) {
        const p = [0, 1, 2].map(k => layer.points[i + k] - m[k]);
        const [x, y] = axes.map(row => row[0] * p[0] + row[1] * p[1] + row[2] * p[2]);
        c.fillStyle = `rgb(${[0, 1, 2].map(k => Math.round(255 * layer.colours[i + k])).join(" ")})`;
        c.fillRect(w / 2 + scale * x - 2, h / 2 - scale * y - 2, 4, 4);
      }
    }
  }
}

/** Normals (3N) of the points of a mesh: sums of the normals of their triangles. */
function normals(points, triangles) {
  const sum = new Float32Array(points.length);
  for (let i = 0; i < triangles.length; i += 3) {
    const [a, b, c] = [3 * triangles[i], 3 * triangles[i + 1], 3 * triangles[i + 2]];
    const u = [0, 1, 2].map(k => points[b + k] - points[a + k]), v = [0, 1, 2].map(k => points[c + k] - points[a + k]);
    const n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const p of [a, b, c]) for (let k = 0; k < 3; k++) sum[p + k] += n[k];
  }
  for (let i = 0; i < sum.length; i += 3) {
    const size = Math.hypot(sum[i], sum[i + 1], sum[i + 2]) || 1;
    for (let k = 0; k < 3; k++) sum[i + k] /= size;
  }
  return sum;
}
