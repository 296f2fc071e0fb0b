// The page of `softmap lab`: one run at a time, its frames, the selection, and the steps.

import { ask, connect } from "./link.js";
import { Timeline, mm } from "./plots.js";
import { Scene, colourOf } from "./scene.js";
import { Steps } from "./steps.js";
import { Run, Where } from "./where.js";

const $ = id => document.getElementById(id);
const TABS = ["see", "where", "what", "add", "next"];
const KEPT = 400;      // shapes that are kept for playing
const WORST = 5;       // worst moments that are marked
const SPEED = 20;      // frames per second while playing

let state = null, run = null, where = null, number = 0, frame = 0, mask = null, maskWords = "", playing = 0, tab = "see", most = 1, asked = -1;
let shapes = new Map(), version = 0, worstFrames = [], checking = false;
let broken = { model: "", why: "" };  // the last check that ended in an error, and its accepted steps
const scene = new Scene($("scene"));
const timeline = new Timeline($("timeline"), go, (first, last) => select(Uint8Array.from({ length: run.frames }, (_, k) => Number(k >= first && k <= last)), `frames ${first} to ${last}`));
const steps = new Steps({ say, trial: () => { draw(); label(); }, frame: () => frame, run: () => number, name: () => $("runs").selectedOptions[0]?.textContent ?? "this run" });

function say(text, bad = false) { $("status").textContent = text; $("status").classList.toggle("bad", bad); }
const failed = fault => say(fault.message, true);

// --- the session -------------------------------------------------------------------------

connect(
  event => {
    if (event.event === "busy") say({ check: "Checking …", diagnose: "Diagnosing …" }[event.do] || "Working …");
    if (event.event === "progress") $("progress").textContent = event.line;
    if (event.event === "simulating") steps.simulating(event.share);
    if (event.event === "changed") changed(event.state);
  },
  async () => {
    try {
      broken = { model: "", why: "" };
      changed((await ask("state")).state);
      steps.setLibrary((await ask("library")).library);
    } catch (fault) { failed(fault); }
  },
  words => { say(words, true); pause(); },
);

function changed(now) {
  const before = state;
  state = now;
  if (before === null || before.runs.length !== state.runs.length) {
    $("runs").replaceChildren(...state.runs.map((one, k) => Object.assign(document.createElement("option"), { value: k, textContent: `${one.name} (${one.frames} frames${k ? ", held out" : ""})` })));
  }
  $("model").textContent = `Model: ${state.bundle}${state.effects.length ? ` + ${state.effects.join(", ")}` : ""}`;
  $("model").title = `Session folder: ${state.folder}`;
  $("undo").disabled = !state.accepted.length || Boolean(state.busy);
  $("redo").disabled = !state.undone.length || Boolean(state.busy);
  showCheck();
  steps.setState(state);
  const shown = one => JSON.stringify(one && [one.accepted, one.revision]);
  if (!run || shown(before) !== shown(state)) load(number); else say(ready());
  check();
}

/** Check again after each change of the model: what follows needs it. */
function check() {
  if (checking || state.check.state !== "not done" || state.busy || broken.model === model()) return;
  checking = true;
  ask("check").catch(fault => { broken = { model: model(), why: fault.message }; failed(fault); }).finally(() => { checking = false; });
}

const model = () => JSON.stringify(state.accepted);

function ready() {
  if (state.busy) return "Working …";
  if (state.check.state === "not done" && broken.model === model()) return broken.why;
  return `Ready. Accepted steps: ${state.accepted.length}.`;
}

function showCheck() {
  const check = state.check, passed = check.state === "passed";
  $("check-text").textContent = { passed: "Check passed for these runs and this model.", failed: "Check failed. A diagnosis needs a check that passes.", "not done": "Not checked yet for these runs and this model." }[check.state];
  $("check-text").className = passed ? "good" : check.state === "failed" ? "bad" : "";
  $("check-lines").replaceChildren(...[...check.faults, ...check.remarks].map(line => Object.assign(document.createElement("li"), { textContent: line })));
  $("check").disabled = passed;
}

async function load(which) {
  pause();
  const mine = ++version;
  say("Loading the run …");
  try {
    const answer = await ask("run", { run: which });
    if (mine !== version) return;
    const kept = run && which === number && answer.frames === run.frames;
    number = which;
    run = new Run(answer);
    shapes = new Map();
    if (!kept) { mask = null; frame = worst()[0]?.frame ?? 0; }
    scene.setBody(run.arrays.triangles, run.arrays.rest);
    worstFrames = worst().map(one => one.frame);
    where = new Where($("plots"), run, select);
    most = Math.max(...run.names.map((_, s) => run.rms("before", () => true, s)).filter(Number.isFinite), 1e-6) * 1.5;
    $("legend-high").textContent = `${mm(most)} mm`;
    $("time").max = run.frames - 1;
    $("after-option").hidden = !run.arrays.after;
    $("worst").replaceChildren(...worst().map(one => {
      const button = document.createElement("button");
      button.type = "button";
      button.textContent = `${when(one.frame)}: ${mm(one.error)} mm`;
      button.onclick = () => go(one.frame);
      return button;
    }));
    steps.setRun(run);
    refresh();
    document.body.dataset.loaded = "yes";
    say(ready());
    numbers(mine);
  } catch (fault) { failed(fault); }
}

async function numbers(mine) {
  const put = rows => $("numbers").replaceChildren(...rows.map(([name, value, small]) => {
    const box = document.createElement("div"), dd = document.createElement("dd");
    dd.append(value, Object.assign(document.createElement("small"), { textContent: small }));
    box.append(Object.assign(document.createElement("dt"), { textContent: name }), dd);
    return box;
  }));
  const all = () => true, before = run.rms("before", all), after = run.rms("after", all);
  const first = [["bundle", `${mm(before)} mm`, "RMS, all points"], ...(after === undefined ? [] : [["with the steps", `${mm(after)} mm`, "RMS, all points"]])];
  put(first);
  const answer = (await ask("comparison", { run: number })).comparison;
  if (mine !== version) return;
  const e = answer.error;
  put([...first, ["tip", `${mm(e.tip_rms_mm)} mm`, "RMS"], ["95 % within", `${mm(e.p95_mm)} mm`, "of the points"], ["noise floor", `${mm(answer.noise_floor_mm)} mm`, answer.floor_is_bound ? "upper bound" : "RMS"]]);
  steps.setFloor(answer.floor_is_bound ? 0 : answer.noise_floor_mm || 0);
  const memory = answer.memoryless_floor;
  $("floor").textContent = memory ? `No model without memory has an error below ${mm(memory.mm)} mm on the ${memory.frames} frames of repeated poses; this model has ${mm(memory.error_mm)} mm there.` : "";
}

// --- frames ------------------------------------------------------------------------------

const when = k => run.timeless ? `row ${k}` : `${run.arrays.t[k].toFixed(1)} s`;

/** The worst moments: the largest errors, at least a fiftieth of the run apart. */
function worst() {
  const errors = run.frameErrors[run.newest], order = [...errors.keys()].filter(k => Number.isFinite(errors[k])).sort((a, b) => errors[b] - errors[a]);
  const found = [], apart = Math.max(1, run.frames / 50);
  for (const k of order) {
    if (found.length === WORST) break;
    if (found.every(one => Math.abs(one.frame - k) > apart)) found.push({ frame: k, error: errors[k] });
  }
  return found;
}

function go(to) {
  frame = Math.min(run.frames - 1, Math.max(0, to));
  refresh();
  steps.moved();
}

function refresh(afresh = false) {
  if (!run) return;
  $("time").value = frame;
  $("time").setAttribute("aria-valuetext", when(frame));
  $("time-text").textContent = `frame ${frame}, ${when(frame)}`;
  const errors = run.frameErrors;
  label();
  timeline.show([{ values: errors.before, colour: "before" }, ...(errors.after ? [{ values: errors.after, colour: "after" }] : [])], mask, frame, worstFrames);
  const chosen = mask ? mask.reduce((a, b) => a + b, 0) : 0;
  $("selection").textContent = mask ? `${chosen} of ${run.frames} frames selected (${maskWords}): ${mm(run.rms(run.newest, k => mask[k]))} mm RMS` : `All ${run.frames} frames: ${mm(run.rms(run.newest, () => true))} mm RMS. Drag over a plot to select frames.`;
  $("clear").disabled = !mask;
  if (tab === "where" && !playing) where.show(mask, frame, afresh);
  fetchShape();
}

async function fetchShape() {
  const at = frame, mine = version;
  if (shapes.has(at)) { draw(); return; }
  if (asked >= 0) return;              // one request at a time; the newest frame follows
  asked = at;
  try {
    const answer = await ask("shape", { run: number, frame: at });
    if (mine === version) { if (shapes.size > KEPT) shapes.clear(); shapes.set(at, answer.arrays); }
  } catch (fault) { if (mine === version) failed(fault); asked = -1; return; }
  asked = -1;
  if (frame !== at || mine !== version) fetchShape(); else draw();
}

/** The error of this frame, of each model that is shown. */
function label() {
  const errors = run.frameErrors, shape = shapes.get(frame), trial = shape && steps.trialAt(frame);
  $("frame-error").textContent = `${mm(errors.before[frame])} mm RMS${errors.after ? ` → ${mm(errors.after[frame])} mm` : ""}${trial ? `, trial ${mm(rmsOf(trial, shape))} mm` : ""}`;
}

function rmsOf(points, shape) {
  let sum = 0, count = 0;
  for (let i = 0; i < points.length; i += 3) {
    if (!shape.visible[i / 3]) continue;
    sum += (points[i] - shape.seen[i]) ** 2 + (points[i + 1] - shape.seen[i + 1]) ** 2 + (points[i + 2] - shape.seen[i + 2]) ** 2;
    count += 1;
  }
  return Math.sqrt(sum / count);
}

function colours(points, seen, visible) {
  const found = new Float32Array(points.length), grey = [0.5, 0.55, 0.6];
  for (let i = 0; i < points.length; i += 3) {
    const off = Math.hypot(points[i] - seen[i], points[i + 1] - seen[i + 1], points[i + 2] - seen[i + 2]);
    found.set(visible[i / 3] ? colourOf(off, most) : grey, i);
  }
  return found;
}

function draw() {
  const shape = shapes.get(frame);
  if (!shape) return;
  const mesh = run.arrays.triangles.length > 0, layers = [], trial = steps.trialAt(frame);
  $("trial-option").hidden = !trial;
  const models = [["show-trial", trial], ["show-after", shape.after], ["show-before", shape.before]].filter(([id, points]) => points && $(id).checked);
  models.forEach(([, points], k) => layers.push({ points, colours: colours(points, shape.seen, shape.visible), mesh, alpha: k ? 0.25 : 1, size: 7 }));
  if ($("show-seen").checked) {
    const kept = [...shape.visible.keys()].filter(k => shape.visible[k]), points = new Float32Array(3 * kept.length), tint = new Float32Array(3 * kept.length);
    const shade = matchMedia("(prefers-color-scheme: dark)").matches ? [0.9, 0.94, 1] : [0.1, 0.15, 0.2];
    kept.forEach((k, i) => { points.set(shape.seen.subarray(3 * k, 3 * k + 3), 3 * i); tint.set(shade, 3 * i); });
    layers.unshift({ points, colours: tint, mesh: false, alpha: 1, size: mesh ? 2.5 : 5 });
  }
  scene.setDown(...run.down(frame));
  scene.setLayers(layers);
}

function pause() { if (playing) { clearInterval(playing); playing = 0; $("play").textContent = "Play"; if (run) refresh(); } }
function play() {
  if (playing || !run) { pause(); return; }
  $("play").textContent = "Pause";
  const chosen = () => { for (let k = 1; k <= run.frames; k++) { const at = (frame + k) % run.frames; if (!mask || mask[at]) return at; } return frame; };
  playing = setInterval(() => { if (asked < 0) go(chosen()); }, 1000 / SPEED);
}

// --- selection and tabs ----------------------------------------------------------------------

function select(chosen, words) {
  mask = chosen && chosen.some(Boolean) ? chosen : null;
  maskWords = words;
  timeline.span = null;
  refresh();
}

function open(name, focus = false) {
  tab = name;
  for (const one of TABS) {
    $(one).hidden = one !== name;
    $(`tab-${one}`).setAttribute("aria-selected", String(one === name));
    $(`tab-${one}`).tabIndex = one === name ? 0 : -1;
  }
  if (focus) $(`tab-${name}`).focus();
  refresh(true);
  steps.draw();
}
/** On a narrow page the steps lie below the finger. */
function show(name) {
  open(name);
  if (matchMedia("(max-width: 820px)").matches) $("steps").scrollIntoView({ block: "start" });
}
for (const name of TABS) {
  $(`tab-${name}`).addEventListener("click", () => show(name));
  $(`tab-${name}`).addEventListener("keydown", event => {
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    if (step) { event.preventDefault(); open(TABS[(TABS.indexOf(name) + step + TABS.length) % TABS.length], true); }
  });
}
$("runs").addEventListener("change", event => load(Number(event.target.value)));
$("time").addEventListener("input", event => { pause(); go(Number(event.target.value)); });
$("timeline").addEventListener("keydown", event => {
  const step = { ArrowLeft: -1, ArrowRight: 1, PageUp: -10, PageDown: 10 }[event.key];
  if (step && run) { event.preventDefault(); go(frame + step); }
});
$("play").addEventListener("click", play);
$("clear").addEventListener("click", () => select(null, ""));
addEventListener("keydown", event => { if (event.key === "Escape" && run) select(null, ""); });
for (const id of ["show-seen", "show-before", "show-after", "show-trial"]) $(id).addEventListener("change", draw);
for (const [id, what] of [["check", "check"], ["undo", "undo"], ["redo", "redo"]]) $(id).addEventListener("click", () => ask(what).catch(failed));
let resized = 0;
addEventListener("resize", () => { cancelAnimationFrame(resized); resized = requestAnimationFrame(() => { refresh(true); steps.draw(); }); });
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { refresh(true); draw(); steps.draw(); });
