// Where in state space the records were: position and velocity of each coordinate.

// Round numbers between two ends.
function ticksOf(low, high, most = 5) {
  const raw = (high - low) / most || 1, unit = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * unit).find((s) => s >= raw);
  const found = [];
  for (let x = Math.ceil(low / step) * step; x <= high + 1e-9 * step; x += step) found.push(x);
  return found.map((x) => Math.round(x / step) * step);
}

// Position and velocity of a coordinate at the points of a cloud, see `featuresOf`.
function pointsOf(cloud, j) {
  if (!cloud) return null;
  const angular = data.coordinates.map((of) => of.kind === "angular");
  const n = angular.length, angles = angular.filter(Boolean).length;
  const before = angular.slice(0, j).filter((is) => is === angular[j]).length;
  const value = (point, i) => point[i] * cloud.spread[i];
  const sine = n - angles + before;
  return {
    q: cloud.points.map((p) => (angular[j] ? Math.atan2(value(p, sine), value(p, sine + angles)) : value(p, before))),
    v: cloud.points.map((p) => value(p, n + angles + j)),
  };
}

function stateChart(host, j) {
  const c = data.coordinates[j], angular = c.kind === "angular";
  const canvas = host.appendChild(element("canvas", {
    class: "states", role: "img", "aria-label": `${c.name} and its velocity in the chosen record`,
  }));
  const range = data.ranges.find(Boolean), points = pointsOf(data.clouds[range?.cloud], j);
  const packed = (key) => data.records.map((r) => [r[key][j].low, r[key][j].high]);
  const frame = range && { q: range.q[j], v: range.v[j] };
  const ends = endsOf([...packed("q"), ...(frame ? [frame.q] : [])]), turning = isTurning(c.kind, ends);
  const pad = ([low, high]) => [low - 0.06 * (high - low), high + 0.06 * (high - low)];
  // in the middle of a turn is where an angle is most
  const most = data.records.map((r) => unpacked(r.q[j])).flat().reduce((sum, q) => sum + Math.cos(q), 0);
  const middle = turning ? (most < 0 ? Math.PI : 0) : (ends[0] + ends[1]) / 2;
  const turns = [-1, -0.5, 0, 0.5, 1].map((k) => [middle + k * Math.PI, (k + middle / Math.PI)])
    .map(([x, k]) => [x, k ? `${k < 0 ? "\u2212" : ""}${{ 0.5: "\u03c0/2", 1: "\u03c0", 1.5: "3\u03c0/2", 2: "2\u03c0" }[Math.abs(k)]}` : "0"]);
  const qs = pad(turning ? [middle - Math.PI, middle + Math.PI] : ends);
  const vs = pad(endsOf([...packed("v"), ...(frame ? [frame.v] : [])]));
  // what stays while time goes on
  const drawStill = (context, width, height, { left, right, top, bottom, px, py, place }) => {
    context.font = "11px system-ui, sans-serif";
    context.strokeStyle = colours.line;
    context.fillStyle = colours.quiet;
    context.lineWidth = 1;
    context.beginPath();
    context.textAlign = "center";
    for (const [x, text] of turning ? turns : ticksOf(...qs).map((x) => [x, told(x)])) {
      context.moveTo(px(x), top);
      context.lineTo(px(x), bottom);
      context.fillText(text, px(x), bottom + 14);
    }
    context.fillText(`${c.name} [${c.unit}]`, (left + right) / 2, height - 5);
    context.textAlign = "right";
    for (const v of ticksOf(...vs)) {
      context.moveTo(left, py(v));
      context.lineTo(right, py(v));
      context.fillText(told(v), left - 5, py(v) + 4);
    }
    context.stroke();
    context.save();
    context.translate(11, (top + bottom) / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText(`velocity [${c.unit}/s]`, 0, 0);
    context.restore();
    if (frame) {
      const [low, high] = turning ? [middle - Math.PI, middle + Math.PI] : frame.q;
      context.setLineDash([4, 3]);
      context.strokeStyle = colours.quiet;
      context.strokeRect(px(low), py(frame.v[1]), px(high) - px(low), py(frame.v[0]) - py(frame.v[1]));
      context.setLineDash([]);
    }
    context.fillStyle = faint(colours.accent, 0.55);
    points?.q.forEach((q, k) => context.fillRect(place(q) - 1.5, py(points.v[k]) - 1.5, 3, 3));
    const of = recordAt(clock.record);
    context.strokeStyle = faint(colours.ink, 0.75);
    context.beginPath();
    let before = null;
    of.q[j].forEach((q, k) => {
      const turn = turning ? Math.round((q - middle) / TURN) : 0;
      if (before === turn) context.lineTo(place(q), py(of.v[j][k]));
      else context.moveTo(place(q), py(of.v[j][k]));
      before = turn;
    });
    context.stroke();
  };
  const still = document.createElement("canvas");
  let drawn = "";
  const draw = () => {
    const { context, width, height } = sharp(canvas);
    if (!width) return;
    const left = 46, bottom = height - 34, right = width - 8, top = 8;
    const px = (q) => left + ((q - qs[0]) / (qs[1] - qs[0] || 1)) * (right - left);
    const py = (v) => bottom - ((v - vs[0]) / (vs[1] - vs[0] || 1)) * (bottom - top);
    const place = (q) => px(angular ? middle + wrapped(q - middle) : q);
    const wanted_ = [clock.record, canvas.width, canvas.height, colours.ink].join();
    if (drawn !== wanted_) {
      drawn = wanted_;
      [still.width, still.height] = [canvas.width, canvas.height];
      const under = still.getContext("2d");
      under.setTransform(context.getTransform());
      drawStill(under, width, height, { left, right, top, bottom, px, py, place });
    }
    context.drawImage(still, 0, 0, width, height);
    const of = recordAt(clock.record), now = at(of.t, [of.q[j], of.v[j]], clock.time);
    context.fillStyle = colours.ink;
    context.strokeStyle = colours.paper;
    context.lineWidth = 2;
    context.beginPath();
    context.arc(place(now[0]), py(now[1]), 5, 0, TURN);
    context.fill();
    context.stroke();
  };
  let seen = true;
  new IntersectionObserver((all) => { seen = all.at(-1).isIntersecting; if (seen) draw(); })
    .observe(canvas);
  clock.listeners.add(() => { if (seen) draw(); });
  repaint.add(draw);
  new ResizeObserver(draw).observe(canvas);
}

function stateCharts() {
  data.coordinates.forEach((_, j) => stateChart($("plots-states"), j));
}
