// The mechanism in motion: measured, and simulated by each model beside it.

const TRAIL = 0.4; // s

function travelOf() {
  return data.coordinates.map((_, i) => endsOf(data.records.map((r) => [r.q[i].low, r.q[i].high])));
}

const mechanismFor = (whole) => (data.links.length
  ? new Chain(data.links, data.coordinates, travelOf(), whole)
  : new Dials(data.coordinates, travelOf()));

function beginStage() {
  const canvas = $("stage"), mechanism = mechanismFor(false);
  const trailOf = (t, signals, now) => {
    if (!data.links.length) return [];
    const found = [];
    for (let i = 0; i <= 32; i++) {
      const then = now - TRAIL * (1 - i / 32);
      const q = then < 0 ? null : at(t, signals, then);
      if (q) found.push(q);
    }
    return found;
  };
  const draw = () => {
    const { context, width, height } = sharp(canvas);
    if (!width) return;
    const of = recordAt(clock.record), poses = [], visible = shown();
    of.runs.forEach((run, i) => {
      const q = visible[i] && at(of.t, run.q, clock.time);
      if (q) poses.push({ q, colour: colourOf(i), dash: dashOf(i), width: 2.5,
        trail: trailOf(of.t, run.q, clock.time) });
    });
    const q = at(of.t, of.q, clock.time);
    poses.unshift({ q, colour: colours.ink, width: 4.5, trail: trailOf(of.t, of.q, clock.time) });
    mechanism.draw(context, width, height, poses);
  };
  clock.listeners.add(draw);
  repaint.add(draw);
  new ResizeObserver(draw).observe(canvas);
  for (const box of document.querySelectorAll(".shown")) box.addEventListener("change", draw);
}
