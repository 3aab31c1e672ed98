// The mechanism in motion: measured, and simulated by each model beside it.

const TRAIL = 0.4, MOMENT = 0.0125; // s

function travelOf() {
  return data.coordinates.map((_, i) => endsOf(data.records.map((r) => [r.q[i].low, r.q[i].high])));
}

const mechanismFor = (whole) => (data.links.length
  ? new Linkage(data.links, data.coordinates, travelOf(), whole)
  : new Dials(data.coordinates, travelOf()));

function beginStage() {
  const canvas = $("stage"), mechanism = mechanismFor(false);
  // where the tips were: at moments that stay the same, so that each is computed once
  const passed = new Map();
  clock.choosers.add(() => passed.clear());
  const trailOf = (who, t, signals, now) => {
    if (!data.links.length) return [];
    const found = [], last = Math.floor(now / MOMENT);
    for (let k = Math.max(0, Math.ceil((now - TRAIL) / MOMENT)); k <= last; k++) {
      const key = `${who} ${k}`;
      if (!passed.has(key)) {
        const q = at(t, signals, k * MOMENT);
        passed.set(key, q && mechanism.ends(q));
      }
      if (passed.get(key)) found.push(passed.get(key));
    }
    const q = at(t, signals, now);
    return q ? [...found, mechanism.ends(q)] : found;
  };
  const draw = () => {
    const { context, width, height } = sharp(canvas);
    if (!width) return;
    const of = recordAt(clock.record), poses = [], visible = shown();
    of.runs.forEach((run, i) => {
      const q = visible[i] && at(of.t, run.q, clock.time);
      if (q) poses.push({ q, colour: colourOf(i), dash: dashOf(i), width: 2.5,
        trail: trailOf(i, of.t, run.q, clock.time) });
    });
    const q = at(of.t, of.q, clock.time);
    poses.unshift({ q, colour: colours.ink, width: 4.5, trail: trailOf(-1, of.t, of.q, clock.time) });
    mechanism.draw(context, width, height, poses);
  };
  clock.listeners.add(draw);
  repaint.add(draw);
  new ResizeObserver(draw).observe(canvas);
  for (const box of document.querySelectorAll(".shown")) box.addEventListener("change", draw);
}
