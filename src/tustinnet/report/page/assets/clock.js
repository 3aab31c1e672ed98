// The time in the chosen record: what plays, and who is told.

const clock = {
  record: 0, time: 0, speed: 1, playing: false,
  listeners: new Set(), // told of the time
  choosers: new Set(), // told of another record
  get length() { return recordAt(this.record).length; },
  go(time) {
    this.time = Math.min(Math.max(time, 0), this.length);
    for (const tell of this.listeners) tell(this.time);
  },
  choose(record) {
    this.record = record;
    for (const tell of this.choosers) tell(record);
    this.go(0);
  },
  play() {
    if (this.time >= this.length) this.go(0);
    this.playing = true;
    this.since = null;
    requestAnimationFrame(tick);
    showPlaying();
  },
  pause() {
    this.playing = false;
    this.go(this.time); // the values of this moment
    showPlaying();
  },
};

const OFTEN = 50, SELDOM = 120; // ms between two changes of texts while it plays: each costs a layout

function tick(now) {
  if (!clock.playing) return;
  const passed = clock.since === null ? 0 : (now - clock.since) / 1000;
  clock.since = now;
  clock.go(clock.time + Math.min(passed, 0.25) * clock.speed);
  if (clock.time >= clock.length) clock.pause();
  else requestAnimationFrame(tick);
}

function showPlaying() {
  $("play").textContent = clock.playing ? "Pause" : "Play";
}

function beginClock() {
  const time = $("time");
  $("play").addEventListener("click", () => (clock.playing ? clock.pause() : clock.play()));
  time.addEventListener("input", () => {
    const to = Number(time.value);
    clock.pause();
    clock.go(to);
  });
  $("speed").addEventListener("change", () => { clock.speed = Number($("speed").value); });
  $("record").addEventListener("change", () => clock.choose(Number($("record").value)));
  clock.choosers.add((record) => {
    const of = recordAt(record);
    time.max = of.length;
    $("chosen").textContent = of.name;
    for (const out of document.querySelectorAll(".rmse"))
      out.textContent = of.runs[out.dataset.model].rmse.map((x, k) => `${told(x)} ${data.units[k]}`).join(", ");
  });
  let last = 0;
  clock.listeners.add((now) => {
    if (clock.playing && performance.now() - last < OFTEN) return;
    last = performance.now();
    time.value = now;
    const text = `${now.toFixed(2)} s`;
    time.setAttribute("aria-valuetext", text);
    $("clock").textContent = text;
  });
}

// Which models are shown.
const boxes = [...document.querySelectorAll(".shown")];
const shown = () => boxes.map((box) => box.checked);
