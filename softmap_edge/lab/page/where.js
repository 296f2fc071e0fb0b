// The errors of a run by class of frames, and the plots of "Where". A selection is a set of frames.

import { Bars, Scatter } from "./plots.js";

const TITLES = { direction: "Direction of motion", speed: "Speed", dwell: "Time since the last motion", history: "Largest past command",
  command: "Command", time: "Time", orientation: "Orientation", temperature: "Temperature" };

/** A run as the program sends it: squared errors (K, S) in mm² and counts of visible points. */
export class Run {
  constructor(message) {
    const a = message.arrays;
    Object.assign(this, { frames: message.frames, points: message.points, names: message.section_names, classes: message.classes, loops: message.loops,
      timeless: message.timeless, tried: new Set(message.try_frames), arrays: a, sections: message.section_names.length });
    this.frameErrors = { before: this.perFrame(a.before), ...(a.after && { after: this.perFrame(a.after) }) };
  }

  perFrame(squared) {
    const found = new Float32Array(this.frames), S = this.sections, counts = this.arrays.counts;
    for (let k = 0; k < this.frames; k++) {
      let sum = 0, count = 0;
      for (let s = 0; s < S; s++) { sum += squared[k * S + s]; count += counts[k * S + s]; }
      found[k] = count ? Math.sqrt(sum / count) : NaN;
    }
    return found;
  }

  /** RMS over frames for which `inside(k)`, of one section or of all. */
  rms(which, inside, section = -1) {
    const squared = this.arrays[which], counts = this.arrays.counts, S = this.sections;
    if (!squared) return undefined;
    let sum = 0, count = 0;
    for (let k = 0; k < this.frames; k++) {
      if (!inside(k)) continue;
      const [first, end] = section < 0 ? [0, S] : [section, section + 1];
      for (let s = first; s < end; s++) { sum += squared[k * S + s]; count += counts[k * S + s]; }
    }
    return count ? Math.sqrt(sum / count) : NaN;
  }

  /** Gravity in a frame and its mean over the run, in the base frame; nothing where it is not declared. */
  down(frame) {
    const g = this.arrays.gravity;
    if (!g) return [];
    this.usual ??= [0, 1, 2].map(k => g.reduce((sum, x, i) => i % 3 === k ? sum + x : sum, 0) / this.frames);
    return [g.subarray(3 * frame, 3 * frame + 3), this.usual];
  }

  /** The model that is shown last: after the steps if there are any. */
  get newest() { return this.arrays.after ? "after" : "before"; }
}

/** Plots of a run in `root`; `select(mask, words)` is called with each brush, null clears. */
export class Where {
  constructor(root, run, select) {
    this.run = run;
    this.plots = [];
    root.replaceChildren();
    const put = (title, plot, show) => {
      const box = document.createElement("div"), head = document.createElement("h3");
      head.textContent = title;
      box.append(head, plot.canvas);
      root.append(box);
      this.plots.push({ plot, show });
    };
    const mask = inside => Uint8Array.from({ length: run.frames }, (_, k) => Number(inside(k)));
    const body = new Bars("Along the body", run.names, null);
    put("Along the body", body, chosen => body.show(run.names.map((_, s) => this.row(chosen, () => true, s)), this.scale));
    const C = run.arrays.command.length / run.frames;
    if (C > 1) {
      const column = c => Float32Array.from({ length: run.frames }, (_, k) => run.arrays.command[k * C + c]);
      const [x, y] = [column(0), column(1)];
      const map = new Scatter("Error by command", "command 0", "command 1", inside => select(inside && mask(k => inside(x[k], y[k])), "commands in the rectangle"));
      put("Error by command (colour: error)", map, (chosen, frame) => map.show([{ x, y, errors: run.frameErrors[run.newest] }], chosen, this.most, frame));
    }
    run.loops.forEach((name, n) => {
      const a = run.arrays, x = a[`loop${n}_command`], seen = a[`loop${n}_seen`];
      const loop = new Scatter(`Loop of the ${name}`, "command", "mm", inside => select(inside && mask(k => inside(x[k], seen[k])), `part of the loop of the ${name}`));
      const sets = [["before", "before"], ["after", "after"], ["seen", "seen"]].filter(([key]) => a[`loop${n}_${key}`]).map(([key, tint]) => ({ x, y: a[`loop${n}_${key}`], colour: tint }));
      put(`Command–tip loop: ${name}`, loop, (chosen, frame) => loop.show(sets, chosen, 1, frame));
    });
    for (const [name, labels] of Object.entries(run.classes)) {
      const title = TITLES[name] || name, index = run.arrays[`class_${name}`];
      const bars = new Bars(title, labels, (first, last) => {
        for (const { plot } of this.plots) if (plot !== bars && plot.chosen) plot.chosen = [0, -1];
        select(mask(k => index[k] >= first && index[k] <= last), `${title.toLowerCase()}: ${first === last ? labels[first] : `${labels[first]} to ${labels[last]}`}`);
      });
      put(title, bars, chosen => bars.show(labels.map((_, n) => this.row(chosen, k => index[k] === n)), this.scale));
    }
    const errors = run.frameErrors.before;
    this.most = errors.reduce((top, value) => value > top ? value : top, 0) || 1;
    this.scale = Math.max(...run.names.map((_, s) => run.rms("before", () => true, s)).filter(Number.isFinite), 1e-6);
    const legend = document.createElement("p");
    legend.className = "hint";
    legend.textContent = "RMS error in mm. Orange: the bundle. Green: with the accepted steps. Blue: the selected frames. In loops, grey is measured.";
    root.prepend(legend);
  }

  row(chosen, inside, section = -1) {
    const run = this.run;
    return { dim: Boolean(chosen), all: run.rms("before", inside, section), after: run.rms("after", inside, section),
      part: chosen ? run.rms(run.newest, k => chosen[k] && inside(k), section) : NaN };
  }

  /** Draw the plots; bars change with the selection only, or when drawn `afresh`. */
  show(chosen, frame, afresh = false) {
    const same = this.shown === chosen && !afresh;
    this.shown = chosen;
    if (!chosen) for (const { plot } of this.plots) { if (plot.chosen) plot.chosen = [0, -1]; else plot.box = null; }
    for (const { plot, show } of this.plots) if (!same || plot instanceof Scatter) show(chosen, frame);
  }
}
