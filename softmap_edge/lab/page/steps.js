// The steps "What", "Add" and "Next": the diagnosis, the chain of effects with its sliders, experiments.

import { ask } from "./link.js";
import { columns, mm } from "./plots.js";

const $ = id => document.getElementById(id);
const STEPS = 200;          // positions of a slider; logarithmic where the range spans decades

const make = (kind, text = "", more = {}) => Object.assign(document.createElement(kind), { textContent: text, ...more });

function table(heads, rows) {
  const found = make("table"), head = found.createTHead().insertRow();
  for (const text of heads) head.append(make("th", text, { scope: "col" }));
  const body = found.createTBody();
  for (const row of rows) {
    const line = body.insertRow();
    for (const cell of row) line.append(make("td", String(cell)));
  }
  const wide = make("div", "", { className: "wide" });
  wide.append(found);
  return wide;
}

const percent = share => Number.isFinite(share) ? `${(100 * share).toFixed(0)} %` : "–";
const number = x => Number.isFinite(x) ? Number(x.toPrecision(4)).toString() : "–";

export class Steps {
  constructor(page) {
    this.page = page; this.state = null; this.library = []; this.run = null; this.diagnosis = null;
    this.floor = 0; this.names = []; this.params = {}; this.trying = false; this.again = false; this.trial = null;
    $("library").addEventListener("change", () => this.doc());
    $("take").addEventListener("click", () => this.take());
    $("reset").addEventListener("click", () => this.reset());
    $("fit").addEventListener("click", () => this.fit());
    $("accept").addEventListener("click", () => this.accept());
    $("simulate").addEventListener("click", () => this.simulate());
    $("diagnose").addEventListener("click", () => this.diagnose());
  }

  setLibrary(library) {
    this.library = library;
    const families = new Map();
    for (const one of library) families.set(one.family, [...(families.get(one.family) || []), one]);
    $("library").replaceChildren(...[...families].map(([family, members]) => {
      const group = make("optgroup", "", { label: family });
      group.append(...members.map(one => make("option", one.name, { value: one.name })));
      return group;
    }));
    this.doc();
    this.reset();
  }

  info(name) { return this.library.find(one => one.name === name); }
  doc() { $("effect-doc").textContent = this.info($("library").value)?.doc || ""; }

  setState(state) {
    const before = this.state, accepted = one => JSON.stringify(one && [one.accepted, one.effects]);
    this.state = state;
    const passed = state.check.state === "passed" && !state.busy;
    $("diagnose").disabled = !passed;
    $("diagnose").title = passed ? "" : "Needs a check that passes for these runs and this model (step 1)";
    if (!passed && !state.busy) $("progress").textContent = "Needs a check that passes for these runs and this model: open step 1.";
    else if (passed) $("progress").textContent = state.diagnosis_current ? "Diagnosis of these runs and this model." : "Takes a minute or less for a run of a few minutes.";
    $("simulate").disabled = !state.diagnosis_current || Boolean(state.busy);
    $("simulated").textContent = state.diagnosis_current ? "Simulates each recording with each hypothesis. This takes up to a minute; nothing moves." : "Needs a diagnosis of these runs and this model: open step 3.";
    if (accepted(before) !== accepted(state)) this.reset();
    else this.buttons();
    if (!before || JSON.stringify(before) !== JSON.stringify(state)) ask("diagnosis").then(answer => { this.diagnosis = answer.diagnosis; this.found(); }, fault => this.page.say(fault.message, true));
  }

  setFloor(floor) { this.floor = floor; this.draw(); }
  setRun(run) { this.run = run; this.trial = null; this.floor = 0; this.draw(); if (this.changed()) this.tries(); }
  moved() { if (this.changed()) this.tries(); }
  trialAt(frame) { return this.trial && this.trial.frame === frame && this.trial.run === this.page.run() ? this.trial.points : null; }

  // --- what ----------------------------------------------------------------------------------

  async diagnose() {
    $("diagnose").disabled = true;
    try { await ask("diagnose"); } catch (fault) { this.page.say(fault.message, true); $("progress").textContent = fault.message; }
  }

  found() {
    const d = this.diagnosis, root = $("found");
    root.replaceChildren();
    $("experiments").replaceChildren();
    if (!d) { root.append(make("p", "No diagnosis yet.", { className: "hint" })); $("experiments").append(make("p", "A diagnosis proposes experiments; diagnose first (step 3).", { className: "hint" })); return; }
    if (!this.state.diagnosis_current) root.append(make("p", "This diagnosis is of an earlier model. Diagnose again for the present one.", { className: "hint" }));
    root.append(make("p", `Verdict: ${d.verdict_text}`, { className: "verdict" }), make("p", d.sentence));
    if (d.removed > 0) root.append(make("p", `${percent(d.removed)} of the removable error is gone: the held-out error above the floor.`));
    if (d.effects.length) {
      const adopt = make("button", `Accept ${d.effects.map(one => one.name).join(", ")}`, { type: "button", id: "adopt", disabled: !this.state.diagnosis_current || this.state.check.state !== "passed" || Boolean(this.state.busy) });
      adopt.onclick = () => ask("accept_diagnosis").catch(fault => this.page.say(fault.message, true));
      root.append(adopt);
    }
    const e = d.error || {}, spread = e.per_fold?.length > 1 ? deviation(e.per_fold) / Math.sqrt(e.per_fold.length) : 0;
    const rows = [["model", e.model, "before"], ["static baseline", e.static_residual, "quiet"], ...(e.ladder || []).map(one => [`+ ${one.added}`, one.value, "after"])].filter(row => Number.isFinite(row[1]));
    if (rows.length) {
      const canvas = make("canvas", "", { className: "plot", id: "evidence" });
      canvas.setAttribute("role", "img");
      canvas.setAttribute("aria-label", `Held-out error: ${rows.map(row => `${row[0]} ${mm(row[1])} ${e.unit}`).join(", ")}`);
      root.append(make("h2", `Error held out, RMS ${e.unit || "mm"}`), canvas, make("p", `Held out on ${e.held_out_on || "blocks"}.${e.floor ? ` Floor: ${e.floor_kind}.` : ""}${spread ? " Bar: standard error over the folds." : ""}`, { className: "hint" }));
      this.evidence = () => columns(canvas, rows.map(([label, value, tint], k) => ({ label, value, colour: tint, sigma: k === rows.length - 1 && tint === "after" ? spread : 0 })), e.floor, 130);
    } else this.evidence = null;
    if (d.effects.length) {
      root.append(make("h2", "Effects that the model lacks"), table(["effect", "parameter", "probability", "effect size"], d.effects.map(one => [
        one.name, Object.entries(one.params).map(([label, p]) => `${label.slice(one.name.length + 1)} ${number(p.value)}${p.sigma === null ? "" : ` ± ${Number(p.sigma.toPrecision(2))}`}${p.unit === "1" ? "" : ` ${p.unit}`}`).join("; "),
        percent(one.probability), `${mm(one.displacement_mm?.fitted)} mm`])));
    }
    if (d.families.length) root.append(make("h2", "Families"), table(["family", "law", "share of the explained error", "effect size"], d.families.map(one => [one.name, `${one.law}: ${one.effects.join(", ") || "–"}`, percent(one.share), `${mm(one.moved_mm)} mm`])));
    if (d.alternatives.length) root.append(make("h2", "Alternatives that these data do not exclude"), table(["instead of", "alternative", "why"], d.alternatives.map(one => [one.member, one.effects.join(", "), one.why])));
    if (d.not_testable.length) root.append(make("h2", "What these runs cannot identify"), table(["effect", "why", "what to record"], d.not_testable.map(one => [one.name, one.why, one.experiment ? `${one.experiment} (${number(one.minutes)} min)` : "–"])));
    if (d.remarks?.length) { const list = make("ul"); list.append(...d.remarks.map(line => make("li", line))); root.append(make("h2", "Remarks on the run"), list); }
    this.experiments(d.next);
    this.draw();
  }

  experiments(rows, none = "not simulated") {
    $("experiments").replaceChildren(rows.length ? table(["experiment", "minutes", "settles", "separation (chi²)"], rows.map(one => [one.block + (one.alone || ""), number(one.minutes), one.settles.join(", ") || "–", one.separation === null ? none : number(one.separation)]))
      : make("p", "Nothing is open: the diagnosis proposes no experiment.", { className: "hint" }), make("p", `Separation is the expected chi² difference between the hypotheses; 25 or more is decisive. ${rows.some(one => one.separation !== null) ? "These numbers come from a simulation with the present model" : "It is computed by a simulation"}, before anything is recorded. The command softmap next writes the file that a robot plays.`, { className: "hint" }));
  }

  simulating(share) { $("simulated").textContent = `Simulating the proposed recordings … ${percent(share)}`; }

  async simulate() {
    $("simulate").disabled = true;
    this.simulating(0);
    try {
      this.experiments((await ask("experiments")).experiments, "no simulated block settles it");
      $("simulated").textContent = "Simulated for the present diagnosis.";
    } catch (fault) { $("simulated").textContent = fault.message; }
    $("simulate").disabled = !this.state.diagnosis_current || Boolean(this.state.busy);
  }

  // --- add -----------------------------------------------------------------------------------

  reset() {
    if (!this.state || !this.library.length) return;
    this.names = [...this.state.effects];
    this.params = { ...this.state.params };
    this.trial = null;
    this.list();
    this.buttons();
    $("trial").textContent = "";
    this.page.trial();
    this.draw();
  }

  changed() { return this.state && (JSON.stringify(this.names) !== JSON.stringify(this.state.effects) || JSON.stringify(sorted(this.params)) !== JSON.stringify(sorted(this.state.params))); }

  buttons() {
    const free = this.state && this.state.check.state === "passed" && !this.state.busy;
    $("fit").disabled = !free || !this.names.length;
    $("accept").disabled = !free || !this.changed();
  }

  take() {
    const info = this.info($("library").value);
    if (!info || this.names.includes(info.name)) return;
    this.names.push(info.name);
    for (const p of info.parameters) this.params[p.label] = p.start;
    this.list();
    this.tries();
  }

  drop(name) {
    this.names = this.names.filter(one => one !== name);
    this.params = Object.fromEntries(Object.entries(this.params).filter(([label]) => label.split(".")[0] !== name));
    this.list();
    this.tries();
  }

  list() {
    $("chain").replaceChildren(...this.names.map(name => {
      const box = make("div", "", { className: "effect" }), head = make("div", "", { className: "row" }), remove = make("button", "Remove", { type: "button" });
      remove.setAttribute("aria-label", `Remove ${name}`);
      remove.onclick = () => this.drop(name);
      head.append(make("h3", name), remove);
      box.append(head);
      for (const label of Object.keys(this.params).filter(one => one.split(".")[0] === name)) box.append(this.slider(name, label));
      return box;
    }));
    if (!this.names.length) $("chain").append(make("p", "The model has no effects. Choose one and add it.", { className: "hint" }));
  }

  slider(name, label) {
    const known = this.info(name)?.parameters.find(p => p.label === label || label.startsWith(`${p.label}[`)) || { low: 0, high: 1, unit: "", doc: "" };
    const low = Math.min(known.low, this.params[label]), high = Math.max(known.high, this.params[label]);
    const row = make("label", "", { className: "parameter", title: known.doc }), bar = make("input", "", { type: "range", min: 0, max: STEPS }), box = make("input", "", { type: "number", step: "any" });
    const value = at => low + (high - low) * (at / STEPS) ** 2, place = v => STEPS * Math.sqrt(Math.max(0, v - low) / (high - low || 1));
    const even = low < 0, to = at => even ? low + (high - low) * at / STEPS : value(at), from = v => even ? STEPS * (v - low) / (high - low || 1) : place(v);
    bar.value = from(this.params[label]);
    box.value = number(this.params[label]);
    const set = (v, other) => { if (!Number.isFinite(v)) return; this.params[label] = known.integer ? Math.round(v) : v; other(); this.tries(); };
    bar.addEventListener("input", () => set(to(Number(bar.value)), () => { box.value = number(this.params[label]); }));
    box.addEventListener("change", () => set(Number(box.value), () => { bar.value = from(this.params[label]); }));
    const short = label.slice(name.length + 1);
    bar.setAttribute("aria-label", label);
    box.setAttribute("aria-label", `${label}, number`);
    row.append(make("span", known.unit && known.unit !== "1" ? `${short} (${known.unit})` : short), bar, box);
    return row;
  }

  /** Try the chain as it stands; while an answer is due, only the newest trial waits. */
  async tries() {
    this.buttons();
    if (!this.run) return;
    if (this.trying) { this.again = true; return; }
    this.trying = true;
    const frame = this.page.frame(), run = this.page.run();
    try {
      const answer = await ask("try", { run, frame, effects: this.names, params: this.params });
      this.trial = { frame, run, points: answer.arrays.points };
      this.base ??= {};
      const tried = this.run.tried, now = this.run.rms(this.run.newest, k => tried.has(k)), off = answer.rms_mm - now;
      const judged = Math.abs(off) < 0.005 * now ? "no change" : off < 0 ? "better" : "worse";
      $("trial").textContent = `Trial on ${this.page.name()}: ${mm(now)} → ${mm(answer.rms_mm)} mm RMS, ${judged}${tried.size < this.run.frames ? ` (${tried.size} of ${this.run.frames} frames)` : ""}.`;
      $("trial").className = { better: "good", worse: "bad" }[judged] ?? "";
      this.page.trial();
    } catch (fault) { $("trial").textContent = fault.message; $("trial").className = "bad"; }
    this.trying = false;
    if (this.again) { this.again = false; this.tries(); }
  }

  async fit() {
    $("fit").disabled = true;
    $("trial").textContent = "Fitting to the first run …";
    try {
      const answer = (await ask("fit", { effects: this.names, params: this.params })).fit;
      this.params = answer.values;
      this.list();
      await this.tries();
      $("trial").textContent += ` The fit on the first run, at the places that a diagnosis compares: ${mm(answer.before_rms_mm)} mm before, ${mm(answer.after_held_out_rms_mm)} mm on blocks held out.`;
    } catch (fault) { $("trial").textContent = fault.message; $("trial").className = "bad"; }
    this.buttons();
  }

  async accept() {
    $("accept").disabled = true;
    try { await ask("accept", { effects: this.names, params: this.params }); } catch (fault) { this.page.say(fault.message, true); this.buttons(); }
  }

  draw() {
    if (!this.state) return;
    this.evidence?.();
    const run = this.page.run(), base = this.state.base_errors_mm[run] ?? this.run?.rms("before", () => true);
    if (!Number.isFinite(base)) return;
    const rows = [{ label: "bundle", value: base }, ...this.state.accepted.map((step, k) => ({ label: `${k + 1} ${step.effects.join(", ") || "none"}`, value: step.errors_mm[run] ?? NaN, colour: "after" }))].filter(row => Number.isFinite(row.value));
    columns($("ladder"), rows, this.floor, 120);
    $("ladder").setAttribute("aria-label", rows.map(row => `${row.label} ${mm(row.value)} mm`).join(", "));
    const held = run > 0;
    $("ladder-text").textContent = `RMS in mm over all points of ${this.state.runs[run].name}; ${held ? "this run is held out: nothing was fitted to it." : "fits use this run. Choose another run above for the held-out error, or see step 3."}`;
  }
}

const sorted = object => Object.entries(object).sort(([a], [b]) => a < b ? -1 : 1);
function deviation(values) {
  const mean = values.reduce((a, b) => a + b, 0) / values.length;
  return Math.sqrt(values.reduce((sum, x) => sum + (x - mean) ** 2, 0) / (values.length - 1));
}
