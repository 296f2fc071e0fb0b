// The page of `softmap teleop`: draws the state in page.js and the operator's inputs, and changes neither.
"use strict";

const TRAIL = 60;        // past positions of the tip that are drawn
const LINKS = [[0, 1, 2, 3, 4], [0, 5, 6, 7, 8], [5, 9, 10, 11, 12], [9, 13, 14, 15, 16], [13, 17, 18, 19, 20], [0, 17]];
const trail = [];

let scheduled = false, drawnPoints = null, drawnLook = "";
function schedule() { if (!scheduled) { scheduled = true; requestAnimationFrame(() => { scheduled = false; draw(); }); } }

const colour = name => getComputedStyle(document.body).getPropertyValue(`--${name}`).trim();

function clear(canvas) {
  const ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight;
  if (canvas.width !== Math.round(w * ratio) || canvas.height !== Math.round(h * ratio)) {
    canvas.width = Math.round(w * ratio);
    canvas.height = Math.round(h * ratio);
  }
  const c = canvas.getContext("2d");
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  c.clearRect(0, 0, w, h);
  c.font = "12px system-ui, 'DejaVu Sans', sans-serif";
  c.lineJoin = c.lineCap = "round";
  return [c, w, h];
}

function words() {
  if (refused) return refused;
  if (!opened) return "Connection lost: the key counts as released; the finger holds, then releases tension. Reconnecting …";
  if (!state) return "Connecting to the program …";
  let text = state.said + ".";
  if (state.slow_ms) text += ` Messages of this page arrive up to ${(state.slow_ms / 1000).toFixed(1)} s late; driving needs less than 0.25 s.`;
  if (state.stage === "lost") text += ` ${state.lost[0].toUpperCase()}${state.lost.slice(1)}.`;
  else if (state.stage === "waiting" && state.why) text += ` Waiting: ${state.why}.`;
  else if (state.stage === "released" && state.lacking && state.level === "ready") text += ` Not yet: ${state.lacking}.`;
  else if (state.stage === "released" && state.level === "ready") text += " Hold the button or Space to drive.";
  else if (state.stage === "driving" && state.who !== "the page") text += ` By ${state.who}.`;
  if (state.limits.length && state.level === "driving") text += ` Limit: ${state.limits.join(", ")}.`;
  return text;
}

function draw() {
  const level = opened && state ? state.level : "off";
  document.body.dataset.level = level;
  $("state").textContent = !opened ? "Not connected" : state ? state.name || "Starting" : "Connecting";
  $("said").textContent = words();
  $("latency").textContent = state && state.latency_ms !== null && state.latency_ms !== undefined && opened ? `${state.latency_ms.toFixed(0)} ms` : "–";
  $("link").textContent = opened ? `live${state && state.pages > 1 ? `, ${state.pages} pages` : ""}` : "lost";
  const seat = opened && state ? state.seat : null;
  $("seat").textContent = { mine: "drive", free: "watch", taken: "watch" }[seat] || "–";
  $("hold").disabled = seat !== "mine";
  $("hold").classList.toggle("held", holders.size > 0);
  $("hold").classList.toggle("lost", holders.size > 0 && state !== null && state.stage === "lost");
  $("hold").firstElementChild.textContent = seat && seat !== "mine" ? "Another page drives" : holders.size === 0 ? "Hold to drive"
    : state && state.stage === "driving" ? "Driving" : state && state.stage === "lost" ? "Let go" : "Held";
  $("take").hidden = seat !== "free";
  $("acknowledge").hidden = !(state && (state.state === "fault" || state.state === "homed"));
  for (const one of $("source").children) one.setAttribute("aria-pressed", one.dataset.source === source);
  if (!hello) return;
  $("seeing-title").textContent = source === "hand" ? "Your hand" : "Keys and mouse";
  $("hint").textContent = source === "knob" ? "Drag here, or hold Space and use the arrows or WASD."
    : state && state.seen ? `index finger: forward ${state.seen[0].toFixed(2)}, aside ${state.seen[1].toFixed(2)} hand scales`
    : "Show one hand to the camera, the index finger stretched.";
  if (source === "hand") drawHand(); else drawPad();
  const look = `${level} ${$("body").clientWidth} ${$("body").clientHeight} ${devicePixelRatio}`;
  if (points !== drawnPoints || look !== drawnLook) { drawFinger(); drawnPoints = points; drawnLook = look; }
  drawBars();
}

function drawHand() {
  const [c, w, h] = clear($("eye"));
  if (!state || !state.size) return;
  const [pw, ph] = state.size, scale = Math.min(w / pw, h / ph), ox = (w - pw * scale) / 2, oy = (h - ph * scale) / 2;
  const flip = !hello.mirrored, place = ([x, y]) => [ox + (flip ? pw - x : x) * scale, oy + y * scale];
  c.save();
  c.beginPath();
  c.roundRect(ox, oy, pw * scale, ph * scale, 8);
  c.clip();
  if (picture) {
    c.save();
    if (flip) { c.translate(2 * ox + pw * scale, 0); c.scale(-1, 1); }
    c.drawImage(picture, ox, oy, pw * scale, ph * scale);
    c.restore();
  } else {
    c.fillStyle = "#161c24";
    c.fillRect(ox, oy, pw * scale, ph * scale);
  }
  if (state.hand) {
    for (const [style, width] of [["#0009", 6], [colour("level"), 3]]) {
      c.strokeStyle = style;
      c.lineWidth = width;
      for (const link of LINKS) {
        c.beginPath();
        link.forEach((k, n) => c[n ? "lineTo" : "moveTo"](...place(state.hand[k])));
        c.stroke();
      }
    }
    state.hand.forEach((p, k) => {
      c.beginPath();
      c.arc(...place(p), k === 8 ? 7 : 3.5, 0, 7);
      c.fillStyle = k === 8 ? colour("text") : colour("level");
      c.fill();
    });
  } else label(c, state.gone || (state.age_ms === null ? "no picture yet" : state.age_ms > 300 ? `no picture for ${(state.age_ms / 1000).toFixed(1)} s` : "no hand is seen"), w / 2, oy + 26);
  c.restore();
}

function label(c, text, x, y) {
  c.font = "15px system-ui, 'DejaVu Sans', sans-serif";
  const width = Math.min(c.measureText(text).width + 24, 2 * x - 8);
  c.fillStyle = "#0009";
  c.beginPath();
  c.roundRect(x - width / 2, y - 15, width, 30, 15);
  c.fill();
  c.fillStyle = colour("holding");
  c.textAlign = "center";
  c.textBaseline = "middle";
  c.fillText(text, x, y, width - 20);
}

function pad() {
  const w = $("eye").clientWidth, h = $("eye").clientHeight;
  return { x: w / 2, y: h / 2, half: Math.min(w, h) / 2 - 34 };
}

function drawPad() {
  const [c] = clear($("eye")), { x, y, half } = pad();
  c.strokeStyle = colour("line");
  c.lineWidth = 1;
  for (let k = -4; k <= 4; k++) {
    c.globalAlpha = k === 0 ? 1 : 0.4;
    c.beginPath();
    c.moveTo(x + k * half / 4, y - half); c.lineTo(x + k * half / 4, y + half);
    c.moveTo(x - half, y + k * half / 4); c.lineTo(x + half, y + k * half / 4);
    c.stroke();
  }
  c.globalAlpha = 1;
  c.lineWidth = 2;
  c.beginPath(); c.roundRect(x - half, y - half, 2 * half, 2 * half, 10); c.stroke();
  c.fillStyle = colour("quiet");
  c.textBaseline = "middle";
  c.textAlign = "center";
  c.fillText(`${hello.axes[1]} +`, x, y - half - 14);
  c.fillText(`${hello.axes[1]} −`, x, y + half + 14);
  c.fillText(`${hello.axes[0]} +`, x + half + 26, y);
  c.fillText(`${hello.axes[0]} −`, x - half - 26, y);
  if (!state) return;
  const [kx, ky] = state.knob, here = [x + kx * half, y - ky * half];
  const driving = state.stage === "driving" && state.source === "knob";
  const at = driving ? [x + knob[0] * half, y - knob[1] * half] : here;
  c.strokeStyle = colour("quiet");
  c.setLineDash([3, 5]);
  c.beginPath(); c.moveTo(x, y); c.lineTo(...at); c.stroke();
  c.setLineDash([]);
  const now = share(state.here);
  c.strokeStyle = colour("text");
  c.beginPath(); c.arc(x + now[0] * half, y - now[1] * half, 13, 0, 7); c.stroke();
  c.fillStyle = colour("level");
  c.beginPath(); c.arc(...at, 9, 0, 7); c.fill();
}

const share = at => at.map((v, k) => v < 0 ? -v / hello.box[k][0] : v / hello.box[k][1]);

function tipOf(all) {
  const tip = [0, 0, 0];
  for (const k of hello.tip) for (let d = 0; d < 3; d++) tip[d] += all[3 * k + d] / hello.tip.length;
  return tip;
}

function keepTrail() {
  if (!points || !hello) return;
  const tip = tipOf(points);
  $("tip").textContent = `tip ${tip.map(v => (Math.round(10 * v) / 10 + 0).toFixed(1)).join("  ")} mm`;
  trail.push(tip);
  if (trail.length > TRAIL) trail.shift();
}

function drawFinger() {
  const [c, w, h] = clear($("body"));
  const rest = hello.rest, long = Math.max(...rest.map(p => p[2])), low = Math.min(...rest.map(p => p[2]));
  const stacked = w < 1.15 * h && w < 420, half = stacked ? w : w / 2;
  const wide = Math.max(hello.reach, 0.25 * long), margin = 30;
  const scale = Math.min((half - 20) / (2 * wide), (h - 2 * margin) / (1.06 * long - low));
  [[0, "x"], [1, "y"]].forEach(([axis, name], k) => {
    const cx = half * (k + 0.5), top = Math.max(margin, (h - scale * (long - low)) / 2);
    const place = p => [cx + p[axis] * scale, hello.down ? top + (p[2] - low) * scale : h - top - (p[2] - low) * scale];
    side(c, place, axis, scale, low);
    c.fillStyle = colour("quiet");
    c.textAlign = "center";
    c.textBaseline = "middle";
    c.fillText(`${name} ⟶`, cx, hello.down ? 14 : h - 14);
  });
  c.strokeStyle = colour("line");
  c.beginPath(); c.moveTo(half, 12); c.lineTo(half, h - 12); c.stroke();
  const length = [5, 10, 20, 50, 100, 200].find(v => v * scale > 30) || 500;
  c.strokeStyle = c.fillStyle = colour("quiet");
  c.lineWidth = 2;
  c.beginPath(); c.moveTo(14, h - 14); c.lineTo(14 + length * scale, h - 14); c.stroke();
  c.textAlign = "left";
  c.fillText(`${length} mm`, 20 + length * scale, h - 14);
}

function side(c, place, axis, scale, low) {
  const at = k => place([points[3 * k], points[3 * k + 1], points[3 * k + 2]]);
  const clamped = place([0, 0, low]), plate = 16 * scale;
  c.fillStyle = "#3a4553";
  c.beginPath();
  c.roundRect(clamped[0] - plate, hello.down ? clamped[1] - 9 : clamped[1] + 1, 2 * plate, 8, 3);
  c.fill();
  if (!hello.triangles.length) {
    c.strokeStyle = colour("level");
    c.lineWidth = 8;
    c.beginPath();
    c.moveTo(...clamped);
    for (let k = 0; k < points.length / 3; k++) c.lineTo(...at(k));
    c.stroke();
  } else mesh(c, place, axis);
  c.strokeStyle = colour("text");
  c.lineWidth = 1.5;
  trail.forEach((p, k) => {
    if (!k) return;
    c.globalAlpha = 0.7 * k / trail.length;
    c.beginPath(); c.moveTo(...place(trail[k - 1])); c.lineTo(...place(p)); c.stroke();
  });
  c.globalAlpha = 1;
  if (trail.length) {
    c.fillStyle = colour("text");
    c.beginPath(); c.arc(...place(trail[trail.length - 1]), 4, 0, 7); c.fill();
  }
}

function mesh(c, place, axis) {
  const depth = 1 - axis, sign = axis === 0 ? -1 : 1, faces = [];   // towards the viewer
  const level = colour("level").match(/[0-9a-f]{2}/gi).map(v => parseInt(v, 16));
  const base = level.map((v, k) => 0.45 * v + 0.55 * [196, 204, 214][k]);
  const rest = hello.rest;
  c.fillStyle = "#22272e";
  c.beginPath();
  for (const [i, j, k] of hello.triangles) {
    const p = [place(rest[i]), place(rest[j]), place(rest[k])];
    if ((p[1][0] - p[0][0]) * (p[2][1] - p[0][1]) < (p[1][1] - p[0][1]) * (p[2][0] - p[0][0])) p.reverse();   // one winding
    p.forEach((one, n) => c[n ? "lineTo" : "moveTo"](...one));
  }
  c.fill();
  for (const [i, j, k] of hello.triangles) {
    const p = [i, j, k].map(n => [points[3 * n], points[3 * n + 1], points[3 * n + 2]]);
    const a = p[1].map((v, d) => v - p[0][d]), b = p[2].map((v, d) => v - p[0][d]);
    const normal = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    const size = Math.hypot(...normal) || 1, facing = sign * normal[depth] / size;
    if (facing <= 0) continue;
    const light = 0.35 + 0.55 * facing + 0.25 * Math.max(0, -normal[axis] / size);
    faces.push([sign * (p[0][depth] + p[1][depth] + p[2][depth]), p, Math.min(1.1, light)]);
  }
  faces.sort((a, b) => a[0] - b[0]);
  c.lineWidth = 0.7;
  for (const [, p, light] of faces) {
    c.fillStyle = c.strokeStyle = `rgb(${base.map(v => Math.min(255, Math.round(v * light))).join(",")})`;
    c.beginPath();
    p.forEach((one, n) => c[n ? "lineTo" : "moveTo"](...place(one)));
    c.closePath();
    c.fill();
    c.stroke();
  }
}

function drawBars() {
  if (!state || !state.here) return;
  [...$("bars").children].forEach((bar, k) => {
    const [low, high] = hello.box[k], here = state.here[k], led = state.led[k];
    const percent = v => 100 * (Math.min(high, Math.max(low, v)) - low) / (high - low);
    const zero = percent(0), now = percent(here);
    bar.children[0].textContent = hello.axes[k];
    const [fill, mark] = bar.children[1].children;
    fill.style.left = `${Math.min(zero, now)}%`;
    fill.style.width = `${Math.max(0.6, Math.abs(now - zero))}%`;
    mark.style.left = `${percent(led)}%`;
    const end = Math.min(led - low, high - led) < 0.005 * (high - low);
    bar.classList.toggle("end", end);
    bar.children[2].textContent = `${here.toFixed(2)} ${hello.unit}${end ? ", end" : ""}`;
  });
}
