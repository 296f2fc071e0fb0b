// Plots on a canvas, each with a brush. They draw what they are given and report what is selected.

import { colourOf } from "./scene.js";

export const colour = name => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
export const mm = x => !Number.isFinite(x) ? "–" : x < 1 ? x.toFixed(3) : x < 10 ? x.toFixed(2) : x.toFixed(1);
const MOST_DRAWN = 4000;  // points of a scatter plot; more are thinned evenly

/** Return [context, width, height] of a canvas in CSS pixels, cleared. */
export function clear(canvas, height) {
  const ratio = Math.min(devicePixelRatio || 1, 2);
  if (height) canvas.style.height = `${height}px`;
  const w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
  }
  const c = canvas.getContext("2d");
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.clearRect(0, 0, w, h);
  c.font = "12px system-ui, 'DejaVu Sans', sans-serif";
  c.textBaseline = "middle";
  return [c, w, h];
}

function newCanvas(label) {
  const canvas = document.createElement("canvas");
  canvas.className = "plot";
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", label);
  return canvas;
}

/** Call `moved(from, to, done)` with offsets while the pointer drags over a canvas. */
export function drag(canvas, moved) {
  let from = null;
  const at = event => { const box = canvas.getBoundingClientRect(); return [event.clientX - box.left, event.clientY - box.top]; };
  canvas.addEventListener("pointerdown", event => { if (event.button === 0) { canvas.setPointerCapture(event.pointerId); from = at(event); } });
  canvas.addEventListener("pointermove", event => { if (from) moved(from, at(event), false); });
  canvas.addEventListener("pointerup", event => { if (from) { moved(from, at(event), true); from = null; } });
  canvas.addEventListener("pointercancel", () => { from = null; });
}

/** Bars of classes: RMS of all frames, of the model after the steps, and of the selected frames. */
export class Bars {
  constructor(title, labels, select) {
    this.labels = labels; this.title = title; this.select = select; this.focus = -1; this.chosen = [0, -1];
    this.canvas = newCanvas(`${title}. Up and down choose a class, Enter selects its frames.`);
    this.canvas.style.cursor = select ? "pointer" : "";
    if (!select) return;
    const row = y => Math.min(labels.length - 1, Math.max(0, Math.floor(y / Bars.ROW)));
    drag(this.canvas, (from, to, done) => {
      this.chosen = [row(from[1]), row(to[1])].sort((a, b) => a - b);
      this.draw();
      if (done) select(...this.chosen);
    });
    this.canvas.addEventListener("keydown", event => {
      const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
      if (step) this.focus = Math.min(labels.length - 1, Math.max(0, this.focus + step));
      else if ((event.key === "Enter" || event.key === " ") && this.focus >= 0) { this.chosen = [this.focus, this.focus]; select(this.focus, this.focus); }
      else return;
      event.preventDefault();
      this.draw();
    });
    this.canvas.addEventListener("blur", () => { this.focus = -1; this.draw(); });
  }

  /** Set the rows, each {all, after, part}: RMS in mm, NaN without frames. */
  show(rows, scale) {
    this.rows = rows; this.scale = scale;
    const text = rows.map((row, k) => `${this.labels[k]} ${mm(row.after ?? row.all)} mm`).join(", ");
    this.canvas.setAttribute("aria-label", `${this.title}: ${text}.${this.select ? " Up and down choose a class, Enter selects its frames." : ""}`);
    this.draw();
  }

  draw() {
    if (!this.rows) return;
    const [c, w] = clear(this.canvas, Bars.ROW * this.labels.length), left = Math.min(150, w * 0.42), room = w - left - 52;
    if (w < 10) return;
    this.rows.forEach((row, k) => {
      const y = k * Bars.ROW;
      if (k >= this.chosen[0] && k <= this.chosen[1]) { c.fillStyle = colour("select"); c.globalAlpha = 0.16; c.fillRect(0, y, w, Bars.ROW); c.globalAlpha = 1; }
      if (k === this.focus) { c.strokeStyle = colour("accent"); c.lineWidth = 2; c.strokeRect(1, y + 1, w - 2, Bars.ROW - 2); }
      c.fillStyle = colour("text");
      c.textAlign = "left";
      c.fillText(fitted(c, this.labels[k], left - 6), 0, y + Bars.ROW / 2);
      const shown = [[row.all, "before", row.dim || row.after !== undefined ? 0.35 : 1], [row.after, "after", row.dim ? 0.45 : 1], [row.part, "select", 1]];
      const bars = shown.filter(([value]) => Number.isFinite(value)), high = (Bars.ROW - 6) / Math.max(1, bars.length);
      bars.forEach(([value, name, alpha], i) => {
        c.fillStyle = colour(name);
        c.globalAlpha = alpha;
        c.fillRect(left, y + 3 + i * high, Math.max(1, room * Math.min(1, value / this.scale)), Math.max(2, high - 1));
        c.globalAlpha = 1;
      });
      const last = bars.at(-1);
      c.fillStyle = colour("quiet");
      c.textAlign = "right";
      c.fillText(last && !(row.dim && !Number.isFinite(row.part)) ? mm(last[0]) : "–", w, y + Bars.ROW / 2);
    });
  }
}
Bars.ROW = 22;

function fitted(c, text, room) {
  if (c.measureText(text).width <= room) return text;
  let end = text.length;
  while (end > 1 && c.measureText(`${text.slice(0, end)}…`).width > room) end--;
  return `${text.slice(0, end)}…`;
}

/** Points over two axes with a rectangle as brush. Each set: {x, y, colour | errors}. */
export class Scatter {
  constructor(title, xName, yName, select) {
    this.title = title; this.names = [xName, yName]; this.sets = []; this.box = null;
    this.canvas = newCanvas(`${title}: ${yName} against ${xName}. Drag to select frames.`);
    this.canvas.style.touchAction = "none";
    drag(this.canvas, (from, to, done) => {
      this.box = [from, to].map(p => this.back(p));
      if (!done) { this.draw(); return; }
      const [[x0, y0], [x1, y1]] = this.box;
      const inside = (x, y) => x >= Math.min(x0, x1) && x <= Math.max(x0, x1) && y >= Math.min(y0, y1) && y <= Math.max(y0, y1);
      if (Math.hypot(to[0] - from[0], to[1] - from[1]) < 4) { this.box = null; select(null); } else select(inside);
    });
  }

  show(sets, mask, most, frame) { this.sets = sets; this.mask = mask; this.most = most; this.frame = frame; this.range(); this.draw(); }

  range() {
    const span = key => {
      let low = Infinity, high = -Infinity;
      for (const set of this.sets) for (const value of set[key]) if (Number.isFinite(value)) { low = Math.min(low, value); high = Math.max(high, value); }
      return low < high ? [low - 0.04 * (high - low), high + 0.04 * (high - low)] : [low - 1, low + 1];
    };
    this.x = span("x"); this.y = span("y");
  }

  place(x, y) { return [42 + (x - this.x[0]) / (this.x[1] - this.x[0]) * (this.w - 50), this.h - 24 - (y - this.y[0]) / (this.y[1] - this.y[0]) * (this.h - 32)]; }
  back([x, y]) { return [this.x[0] + (x - 42) / (this.w - 50) * (this.x[1] - this.x[0]), this.y[0] + (this.h - 24 - y) / (this.h - 32) * (this.y[1] - this.y[0])]; }

  draw() {
    if (!this.sets.length) return;
    const [c, w, h] = clear(this.canvas, 220);
    if (w < 10) return;
    [this.w, this.h] = [w, h];
    c.strokeStyle = colour("line");
    c.strokeRect(42, 8, w - 50, h - 32);
    c.fillStyle = colour("quiet");
    c.textAlign = "left"; c.fillText(short(this.x[0]), 42, h - 14);
    c.textAlign = "right"; c.fillText(short(this.x[1]), w - 8, h - 14);
    c.textAlign = "center"; c.fillText(this.names[0], w / 2, h - 10);
    c.textAlign = "right"; c.fillText(short(this.y[1]), 38, 14); c.fillText(short(this.y[0]), 38, h - 28);
    c.save(); c.translate(10, h / 2 - 10); c.rotate(-Math.PI / 2); c.textAlign = "center"; c.fillText(this.names[1], 0, 0); c.restore();
    for (const set of this.sets) {
      const step = Math.max(1, Math.ceil(set.x.length / MOST_DRAWN)), fixed = set.colour && colour(set.colour);
      for (const chosen of this.mask ? [false, true] : [true]) {
        c.globalAlpha = chosen ? 0.9 : 0.15;
        for (let k = 0; k < set.x.length; k += step) {
          if (!Number.isFinite(set.x[k]) || !Number.isFinite(set.y[k]) || (this.mask && Boolean(this.mask[k]) !== chosen)) continue;
          const [x, y] = this.place(set.x[k], set.y[k]);
          c.fillStyle = fixed || `rgb(${colourOf(set.errors[k], this.most).map(v => Math.round(255 * v)).join(" ")})`;
          c.fillRect(x - 1.5, y - 1.5, 3, 3);
        }
      }
      c.globalAlpha = 1;
      if (this.frame < set.x.length && Number.isFinite(set.y[this.frame])) {
        const [x, y] = this.place(set.x[this.frame], set.y[this.frame]);
        c.strokeStyle = colour("text");
        c.lineWidth = 1.5;
        c.beginPath(); c.arc(x, y, 5, 0, 7); c.stroke();
        c.lineWidth = 1;
      }
    }
    if (this.box) {
      const [a, b] = this.box.map(p => this.place(...p));
      c.strokeStyle = colour("select");
      c.strokeRect(a[0], a[1], b[0] - a[0], b[1] - a[1]);
    }
  }
}

const short = x => Math.abs(x) >= 100 ? x.toFixed(0) : x.toPrecision(2);

/** Error over frames, with the selection and the present frame. */
export class Timeline {
  constructor(canvas, go, select) {
    this.canvas = canvas; this.span = null;
    canvas.style.touchAction = "none";
    const frame = x => Math.min(this.count - 1, Math.max(0, Math.round((x - 36) / Math.max(1, this.w - 44) * (this.count - 1))));
    drag(canvas, (from, to, done) => {
      if (!this.count) return;
      const near = Math.abs(to[0] - from[0]) < 4;
      this.span = near ? null : [frame(from[0]), frame(to[0])].sort((a, b) => a - b);
      if (near && done) go(frame(to[0])); else if (done) select(...this.span); else this.draw();
    });
  }

  show(sets, mask, frame, worst) {
    this.sets = sets; this.mask = mask; this.frame = frame; this.worst = worst; this.count = sets[0].values.length;
    this.most = 0;
    for (const set of sets) for (const value of set.values) if (value > this.most) this.most = value;
    this.draw();
  }

  draw() {
    if (!this.sets) return;
    const [c, w, h] = clear(this.canvas, 70), room = w - 44;
    if (w < 60) return;
    this.w = w;
    const x = k => 36 + k / Math.max(1, this.count - 1) * room, y = v => h - 6 - v / (this.most || 1) * (h - 14);
    c.fillStyle = colour("quiet");
    c.textAlign = "right";
    c.fillText(mm(this.most), 32, 10);
    c.fillText("0", 32, h - 8);
    if (this.mask) {
      c.fillStyle = colour("select");
      c.globalAlpha = 0.18;
      for (let k = 0; k < this.count; k++) if (this.mask[k]) c.fillRect(x(k) - 0.5, 4, Math.max(1, room / this.count), h - 8);
      c.globalAlpha = 1;
    } else if (this.span) {
      c.fillStyle = colour("select"); c.globalAlpha = 0.18; c.fillRect(x(this.span[0]), 4, x(this.span[1]) - x(this.span[0]), h - 8); c.globalAlpha = 1;
    }
    for (const set of this.sets) {
      const step = Math.max(1, Math.floor(this.count / (2 * room)));
      c.strokeStyle = colour(set.colour);
      c.beginPath();
      for (let k = 0; k < this.count; k += step) {
        let top = 0;
        for (let i = k; i < Math.min(this.count, k + step); i++) top = Math.max(top, set.values[i] || 0);
        if (k) c.lineTo(x(k), y(top)); else c.moveTo(x(k), y(top));
      }
      c.stroke();
    }
    c.fillStyle = colour("bad");
    for (const k of this.worst) { c.beginPath(); c.moveTo(x(k) - 4, 0); c.lineTo(x(k) + 4, 0); c.lineTo(x(k), 7); c.fill(); }
    c.strokeStyle = colour("text");
    c.beginPath(); c.moveTo(x(this.frame), 2); c.lineTo(x(this.frame), h - 2); c.stroke();
  }
}

/** Bars from left to right with a value above each, perhaps with error bars and a floor. */
export function columns(canvas, rows, floor, height) {
  const [c, w, h] = clear(canvas, height);
  if (w < 10 || !rows.length) return;
  const most = Math.max(...rows.map(row => row.value + (row.sigma || 0)), floor || 0) || 1, each = Math.min(130, (w - 8) / rows.length);
  const y = value => h - 22 - value / most * (h - 44);
  rows.forEach((row, k) => {
    const x = 4 + k * each, wide = each * 0.6;
    c.fillStyle = colour(row.colour || "before");
    c.fillRect(x, y(row.value), wide, y(0) - y(row.value));
    c.strokeStyle = colour("text");
    if (row.sigma) {
      c.beginPath(); c.moveTo(x + wide / 2, y(row.value - row.sigma)); c.lineTo(x + wide / 2, y(row.value + row.sigma)); c.stroke();
    }
    c.fillStyle = colour("text");
    c.textAlign = "left";
    c.fillText(mm(row.value), x, y(row.value + (row.sigma || 0)) - 9);
    c.fillStyle = colour("quiet");
    c.fillText(fitted(c, row.label, each - 6), x, h - 10);
  });
  if (floor) {
    c.strokeStyle = colour("good");
    c.setLineDash([4, 4]);
    c.beginPath(); c.moveTo(0, y(floor)); c.lineTo(w, y(floor)); c.stroke();
    c.setLineDash([]);
    c.fillStyle = colour("good");
    c.textAlign = "right";
    c.fillText(`floor ${mm(floor)}`, w, y(floor) - 8);
  }
}
