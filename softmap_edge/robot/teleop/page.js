// The page of `softmap teleop`: receives the state of the program, which page_drawing.js draws, and reports repeatedly
// whether the key is held.
"use strict";

const SPEED = 0.9;       // of the range per second, while an arrow is held
const SAY = 50;          // ms between two messages; the program releases the key after 250 ms without one
const $ = id => document.getElementById(id);
const ARROWS = { ArrowRight: [1, 0], ArrowLeft: [-1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1],
  KeyD: [1, 0], KeyA: [-1, 0], KeyW: [0, 1], KeyS: [0, -1] };

let hello = null, state = null, points = null, picture = null, socket = null, opened = false, refused = "";
let source = null, knob = [0, 0], shown = 0, lastSaid = 0, cameFrom = null;
const holders = new Set();           // what holds the enable key: "space", "button", "pad"
const down = new Set();              // arrows that are pressed

// --- the connection ---------------------------------------------------------------------

function connect() {
  const token = location.hash.slice(1);
  if (!token) { refused = "Open the link that the program printed: its end is the key to this page."; return draw(); }
  const mine = socket = new WebSocket(`ws://${location.host}/drive?token=${encodeURIComponent(token)}`);
  mine.binaryType = "arraybuffer";
  mine.onopen = () => { opened = true; shown = 0; say(); };
  mine.onmessage = event => {
    if (typeof event.data !== "string") return binary(event.data);
    const message = JSON.parse(event.data);
    if (message.hello) { begin(message.hello); return; }
    state = message;
    shown = message.number;
    if (state.gone && source === "hand") source = "knob";
    if (state.stage === "released" || state.stage === "lost") { if (cameFrom === null) knob = message.knob.slice(); }
    keepTrail();
    say();
    schedule();
  };
  mine.onclose = event => {
    opened = false;
    letGo();
    if (event.code === 1006 && !hello) refused = "The program does not answer, or refuses this link: it may have ended, or was started again with another link.";
    draw();
    setTimeout(connect, 1000);
  };
}

function binary(buffer) {
  const kind = new DataView(buffer).getUint32(0, true);
  if (kind === 2) points = new Float32Array(buffer.slice(8));
  else createImageBitmap(new Blob([buffer.slice(8)], { type: "image/jpeg" })).then(made => { picture?.close(); picture = made; schedule(); }, () => {});
}

function begin(message) {
  hello = message;
  refused = "";
  points = Float32Array.from(message.rest.flat());
  if (source === null) source = message.source;
  $("source").hidden = message.camera === "none";
  $("bars").replaceChildren(...message.axes.map(() => {
    const bar = document.createElement("div");
    bar.className = "bar";
    for (const part of ["name", "track", "value"]) bar.append(Object.assign(document.createElement("span"), { className: part }));
    bar.children[1].append(...["fill", "led"].map(part => Object.assign(document.createElement("span"), { className: part })));
    return bar;
  }));
  schedule();
}

function say(wish) {
  if (!opened || socket.readyState !== WebSocket.OPEN) return;
  if (socket.bufferedAmount > 4096) return;   // nothing is queued; the program releases the key by itself
  lastSaid = performance.now();
  socket.send(JSON.stringify({ t: lastSaid / 1000, held: holders.size > 0, source: source || "knob", knob, shown, ...(wish && { do: wish }) }));
}

// --- what the operator does -------------------------------------------------------------

function hold(what) { holders.add(what); say(); draw(); }
function letGo(what) {
  if (what) holders.delete(what); else { holders.clear(); down.clear(); cameFrom = null; }
  say();
  draw();
}
function ask(wish) { letGo(); say(wish); }

addEventListener("keydown", event => {
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (event.code === "Space") { event.preventDefault(); if (!event.repeat) hold("space"); }
  else if (event.code === "Escape") { event.preventDefault(); ask("stop"); }
  else if (ARROWS[event.code]) { event.preventDefault(); down.add(event.code); }
});
addEventListener("keyup", event => {
  if (event.code === "Space") { event.preventDefault(); letGo("space"); }
  down.delete(event.code);
});
for (const name of ["blur", "pagehide", "contextmenu"]) addEventListener(name, () => letGo());
document.addEventListener("visibilitychange", () => letGo());

$("hold").addEventListener("pointerdown", event => { if (event.button === 0) { event.target.setPointerCapture(event.pointerId); hold("button"); } });
for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) {
  $("hold").addEventListener(name, () => letGo("button"));
  $("eye").addEventListener(name, () => { if (cameFrom) { cameFrom = null; letGo("pad"); } });
}
$("eye").addEventListener("pointerdown", event => {
  if (source !== "knob" || event.button !== 0 || !state) return;
  event.target.setPointerCapture(event.pointerId);
  cameFrom = { id: event.pointerId, at: [event.offsetX, event.offsetY], knob: state.knob.slice() };
  knob = state.knob.slice();
  hold("pad");
});
$("eye").addEventListener("pointermove", event => {
  if (!cameFrom || event.pointerId !== cameFrom.id) return;
  const half = pad().half;
  knob = [clamp(cameFrom.knob[0] + (event.offsetX - cameFrom.at[0]) / half), clamp(cameFrom.knob[1] - (event.offsetY - cameFrom.at[1]) / half)];
  say();
});
$("stop").addEventListener("click", () => ask("stop"));
$("emergency").addEventListener("pointerdown", () => ask("emergency"));
$("emergency").addEventListener("click", () => ask("emergency"));
$("acknowledge").addEventListener("click", () => say("acknowledge"));
$("take").addEventListener("click", () => say("take"));
$("source").addEventListener("click", event => {
  if (!event.target.dataset.source) return;
  source = event.target.dataset.source;
  event.target.blur();
  letGo();
});

const clamp = x => Math.min(1, Math.max(-1, x));
let before = performance.now();
setInterval(() => {
  const now = performance.now(), passed = Math.min(0.1, (now - before) / 1000);
  before = now;
  if (source === "knob" && state && state.stage === "driving") {
    for (const key of down) knob = knob.map((at, k) => clamp(at + SPEED * passed * ARROWS[key][k]));
  }
  if (now - lastSaid >= SAY - 2) say();
}, 25);

addEventListener("resize", schedule);
connect();
draw();
