// The numbers of the page, and small helpers.

const data = JSON.parse(document.getElementById("data").textContent);
const $ = (id) => document.getElementById(id);
const TURN = 2 * Math.PI;

// Whether an angle moves so far that it is shown within a turn; any other as it was recorded.
const isTurning = (kind, [low, high]) => kind === "angular" && high - low > Math.PI;

// An element with attributes and children; text stays text.
function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

// A packed signal as numbers, null where there is none.
function unpacked({ low, high, k }) {
  const bytes = Uint8Array.from(atob(k), (c) => c.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  return Array.from({ length: bytes.length / 2 }, (_, i) => {
    const whole = view.getInt16(2 * i, true);
    return whole === -32768 ? null : low + ((high - low) * (whole + 32767)) / 65534;
  });
}

const opened = new Map();

// A record with its signals as numbers; unpacked when it is first asked for.
function recordAt(index) {
  if (!opened.has(index)) {
    const of = data.records[index];
    const all = (signals) => (signals ?? []).map(unpacked);
    const t = unpacked(of.t), q = all(of.q);
    const runs = of.runs.map((run) => {
      const error = all(run.error);
      const simulated = error.map((e, j) => e.map((x, k) => (x === null ? null : q[j][k] + x)));
      return { rmse: run.rmse, q: simulated, error, band: all(run.band), energy: all(run.energy) };
    });
    opened.set(index, {
      name: of.name, t, q, v: all(of.v), u: all(of.u), runs, length: t[t.length - 1],
    });
  }
  return opened.get(index);
}

// The last index of rising numbers that is not beyond a value.
function placeIn(values, x) {
  let low = 0, high = values.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (values[middle] <= x) low = middle; else high = middle - 1;
  }
  return low;
}

// Signals at a time, on straight lines between their samples; null where there is a gap.
function at(t, signals, time) {
  const i = placeIn(t, time), j = Math.min(i + 1, t.length - 1);
  const share = j > i ? Math.min(Math.max((time - t[i]) / (t[j] - t[i]), 0), 1) : 0;
  const found = signals.map((s) => (s[i] === null || s[j] === null ? null : s[i] + share * (s[j] - s[i])));
  return found.includes(null) ? null : found;
}

// A number for people.
function told(x, digits = 3) {
  if (x === null || x === undefined || Number.isNaN(x)) return "\u2013";
  if (!Number.isFinite(x)) return "diverged";
  return Math.abs(x) >= 1e4 ? x.toExponential(1) : String(Number(x.toPrecision(digits)));
}

// The ends of several signals together.
function endsOf(signals) {
  let low = Infinity, high = -Infinity;
  for (const signal of signals)
    for (const x of signal)
      if (x !== null) { low = Math.min(low, x); high = Math.max(high, x); }
  return low <= high ? [low, high] : [0, 0];
}

// An angle within half a turn to either side.
const wrapped = (angle) => angle - TURN * Math.round(angle / TURN);
