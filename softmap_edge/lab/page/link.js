// The connection of the lab's page: requests with numbered answers, and events of the program.

const pending = new Map();
let socket = null, last = 0;

/** Connect; `events` gets each event, `opened` and `closed` are called with each change. */
export function connect(events, opened, closed) {
  const token = location.hash.slice(1);
  if (!token) { closed("Open the link that the program printed: its end is the key to this page."); return; }
  let heard = false;
  socket = new WebSocket(`ws://${location.host}/lab?token=${encodeURIComponent(token)}`);
  socket.binaryType = "arraybuffer";
  socket.onopen = () => { heard = true; opened(); };
  socket.onmessage = event => {
    const message = typeof event.data === "string" ? { ...JSON.parse(event.data), arrays: {} } : unpack(event.data);
    if (message.event) return events(message);
    const waiting = pending.get(message.re);
    pending.delete(message.re);
    if (!waiting) return;
    if (message.error) waiting.reject(new Error(message.error)); else waiting.resolve(message);
  };
  socket.onclose = () => {
    for (const waiting of pending.values()) waiting.reject(new Error("The connection is lost."));
    pending.clear();
    closed(heard ? "Connection lost. Accepted steps are saved; reconnecting …"
      : "The program does not answer, or refuses this link. Start it again, or open the link that it printed.");
    setTimeout(() => connect(events, opened, closed), 1500);
  };
}

/** Send a request; the promise gives its answer, with `arrays` of Float32Array. */
export function ask(what, more = {}) {
  return new Promise((resolve, reject) => {
    if (!socket || socket.readyState !== WebSocket.OPEN) { reject(new Error("There is no connection.")); return; }
    const id = ++last;
    pending.set(id, { resolve, reject });
    socket.send(JSON.stringify({ id, do: what, ...more }));
  });
}

function unpack(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let at = 4 + length;
  const arrays = {};
  for (const [name, shape] of header.arrays) {
    const count = shape.reduce((a, b) => a * b, 1);
    arrays[name] = new Float32Array(buffer, at, count);
    at += 4 * count;
  }
  return { ...header, arrays };
}
