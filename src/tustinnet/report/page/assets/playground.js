// The exported model, stepped here: dragged to a start, let go, pushed, driven.

const FRAME = 0.02; // s that stepping may take of a frame

class Toy {
  constructor(model, module) {
    Object.assign(this, { model, module });
    const { states, inputs, range, samples } = module, n = data.coordinates.length;
    this.n = n;
    this.before = Math.max(0, ...samples.map((k) => -k));
    // where nobody knows what was recorded, inputs go from -1 to 1
    this.inputEnds = inputs.map((_, i) => data.inputs[i].limits ?? range?.inputs[i] ?? [-1, 1])
      .map(([low, high]) => (high > low ? [low, high] : [low - 1, high + 1]));
    this.range = data.ranges[model];
    this.cloud = data.clouds[this.range?.cloud];
    this.angular = data.coordinates.map((of) => of.kind === "angular");
    this.names = [...states.slice(0, 2 * n), ...inputs];
    this.speeds = Array.from({ length: n }, (_, j) => {
      const [low, high] = range ? range.states[n + j] : [-1, 1];
      return Math.max(Math.abs(low), Math.abs(high)) || 1;
    });
    this.u = inputs.map(() => 0);
    this.pilot = data.controller ? new Pilot(data.controller) : null;
    this.reset(Array(n).fill(0));
  }

  // What acts from now to the next sample: what people add, and what the controller commands.
  drive(added, controlled) {
    if (!this.pilot || !controlled) return added;
    const { lower, upper, delay } = this.pilot.feedback;
    this.commands.push(this.pilot.inputs(this.state.x));
    const command = this.commands.length > delay ? this.commands.shift() : this.pilot.feedback.u0;
    return command.map((x, i) => Math.min(Math.max(x + added[i], lower[i]), upper[i]));
  }

  // The controller begins anew: by its plan from where that begins, else where it holds, or where it
  // has fallen.
  begin() {
    if (!this.pilot) return;
    const { plan, feedback, recovery } = this.pilot, x = this.q;
    const from = (to) => Math.max(...x.map((q, i) => Math.abs(this.angular[i] ? wrapped(q - to[i]) : q - to[i])));
    this.pilot.reset(plan !== null && !recovery && from(plan.x[0]) < from(feedback.x0));
    this.commands = [];
  }

  // At rest at some positions; internal states settle there where the model needs samples for that.
  reset(q) {
    this.state = this.module.init(this.module.states.map((_, i) => (i < this.n ? q[i] : 0)));
    this.past = Array(this.before).fill(this.u.map(() => 0));
    for (let k = 0; k < data.models[this.model].warmUp; k++) {
      this.step(this.u.map(() => 0));
      this.state.x.set(q);
      this.state.x.fill(0, this.n, 2 * this.n);
    }
  }

  get q() { return Array.from(this.state.x.slice(0, this.n)); }

  // One period; inputs of later samples are taken to stay as they are.
  step(u) {
    const seen = this.module.samples.flatMap((k) => (k >= 0 ? u : this.past.at(k)));
    this.module.step(this.state, seen);
    if (this.before) this.past = [...this.past.slice(1), u];
  }

  push() {
    this.state.x[2 * this.n - 1] += 0.4 * this.speeds[this.n - 1];
  }

  // What is outside of what was recorded while inputs act, in words; empty where nothing is.
  outside(u) {
    if (!this.range) return "";
    const { by, together } = this.leaves(this.state.x, u);
    if (by.length) return by.map((i) => this.names[i]).join(", ");
    return together ? "positions, velocities and inputs that did not come together in any record" : "";
  }

  leaves(x, u) {
    const [q, v] = [0, this.n].map((from) => Array.from(x.slice(from, from + this.n)));
    return leaving(this.range, this.cloud, this.angular, q, v, u);
  }
}

// For checks: the states of a free run of one model, from a state, under inputs as a step is given.
globalThis.freeRun = (which, x0, inputs) => {
  const { init, step } = globalThis.exported[which], state = init(x0);
  return [Array.from(state.x), ...inputs.map((u) => Array.from(step(state, u).x))];
};

// For checks: whether states [q, v] under inputs are outside of what a model's records were.
globalThis.isOutside = (model, states, inputs) => {
  const toy = new Toy(model, globalThis.exported[data.exported.indexOf(model)]);
  return states.map((x, k) => {
    const { by, together } = toy.leaves(x, inputs[k]);
    return by.length > 0 || together;
  });
};

function beginPlayground() {
  const canvas = $("toy");
  if (!canvas || !globalThis.exported.length) return;
  const toys = globalThis.exported.map((module, k) => new Toy(data.exported[k], module));
  const choice = $("toy-model"), run = $("toy-run"), status = $("toy-state");
  const controlled = $("toy-controlled"); // only where there is a controller
  toys.forEach((toy, k) =>
    choice.append(element("option", { value: k }, data.models[toy.model].label)));
  const mechanism = mechanismFor(true);
  let toy = toys[0], running = false, since = null, owed = 0, taken = null, trail = [], held = 0, acting = [];
  const begin = [...at(recordAt(0).t, recordAt(0).q, 0)];

  const slider = (host, name, [low, high], value, tell) => {
    const shown = (x) => told(Math.abs(x) < 1e-3 * (high - low) ? 0 : x); // no digits of rounding
    const out = element("output", {}, shown(value));
    const input = element("input", { type: "range", min: low, max: high, step: "any", "aria-label": name });
    input.value = value;
    input.addEventListener("input", () => { out.textContent = shown(Number(input.value)); tell(Number(input.value)); });
    host.append(element("label", { class: "slide" }, element("span", {}, name), input, out));
    return { set(x) { input.value = x; out.textContent = shown(x); } };
  };

  const travel = travelOf().map(([low, high], j) =>
    (isTurning(data.coordinates[j].kind, [low, high]) ? [begin[j] - Math.PI, begin[j] + Math.PI]
      : high > low ? [low, high] : [low - 1, high + 1]));
  const starts = data.coordinates.map((c, j) =>
    slider($("toy-starts"), `${c.name} [${c.unit}]`, travel[j], begin[j], (x) => {
      begin[j] = x;
      stop();
      toy.reset(begin);
      draw();
    }));
  let inputs = [];

  const draw = () => {
    const { context, width, height } = sharp(canvas);
    if (!width) return;
    const out = toy.outside(running ? acting : toy.u), finite = toy.q.every(Number.isFinite);
    const lost = out !== "" || !finite;
    const colour = lost ? colours.grey : colourOf(toy.model);
    if (finite)
      mechanism.draw(context, width, height, [
        { q: toy.q, colour, width: 4.5, trail: data.links.length ? trail : [] }]);
    canvas.dataset.outside = lost;
    const text = !finite ? "The model has left all bounds."
      : lost ? `Outside of what was recorded: ${out}.`
        : toy.range ? "Within what was recorded." : "Nobody knows what was recorded.";
    if (status.textContent !== text) status.textContent = text;
  };

  const tickToy = (now) => {
    if (!running) return;
    owed += since === null ? 0 : Math.min((now - since) / 1000, 0.1);
    since = now;
    const { period } = toy.module, from = performance.now();
    acting = toy.u.map((x, i) => (i === 0 && held ? toy.inputEnds[0][held > 0 ? 1 : 0] : x));
    const added = acting;
    while (owed >= period && performance.now() - from < 1000 * FRAME) {
      acting = toy.drive(added, controlled?.checked);
      toy.step(acting);
      owed -= period;
    }
    if (owed >= period) owed = 0; // slower than time
    if (trail.push(mechanism.ends(toy.q)) > 40) trail.shift();
    draw();
    requestAnimationFrame(tickToy);
  };
  const stop = () => { running = false; trail = []; run.textContent = "Let go"; };
  const go = () => {
    toy.begin();
    running = true;
    since = null;
    owed = 0;
    run.textContent = "Hold";
    requestAnimationFrame(tickToy);
  };

  const choose = () => {
    const u = toy.u;
    toy = toys[Number(choice.value)];
    stop();
    toy.reset(begin);
    toy.u = u;
    draw();
  };
  $("toy-inputs").replaceChildren();
  inputs = data.inputs.map((of, i) =>
    slider($("toy-inputs"), of.unit ? `${of.name} [${of.unit}]` : of.name, toy.inputEnds[i], 0, (x) => {
      toy.u[i] = x;
      draw();
    }));
  choice.addEventListener("change", choose);
  controlled?.addEventListener("change", () => toy.begin());
  run.addEventListener("click", () => (running ? stop() : go()));
  $("toy-push").addEventListener("click", () => { toy.push(); if (!running) go(); });
  $("toy-reset").addEventListener("click", () => {
    stop();
    toy.u.fill(0);
    inputs.forEach((slide) => slide.set(0));
    toy.reset(begin);
    draw();
  });

  const where = (event) => [event.offsetX, event.offsetY, canvas.clientWidth, canvas.clientHeight];
  canvas.addEventListener("pointerdown", (event) => {
    taken = mechanism.near(toy.q, ...where(event));
    if (!taken) return;
    canvas.setPointerCapture(event.pointerId);
    stop();
    toy.q.forEach((x, j) => { begin[j] = x; });
    event.preventDefault();
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!taken) { canvas.classList.toggle("near", Boolean(mechanism.near(toy.q, ...where(event)))); return; }
    const j = taken.coordinate, [low, high] = travel[j];
    const x = mechanism.pulled(begin, taken, ...where(event));
    begin[j] = data.coordinates[j].kind === "angular" ? x : Math.min(Math.max(x, low), high);
    starts[j].set(begin[j]);
    toy.reset(begin);
    draw();
  });
  canvas.addEventListener("pointerup", () => { if (taken) { taken = null; go(); } });
  canvas.addEventListener("pointercancel", () => { taken = null; });
  const keys = { ArrowLeft: -1, ArrowRight: 1 };
  canvas.addEventListener("keydown", (event) => {
    if (event.key in keys) { held = keys[event.key]; if (!running) go(); event.preventDefault(); }
    if (event.key === " ") { run.click(); event.preventDefault(); }
  });
  const release = (event) => { if (event.type === "blur" || event.key in keys) held = 0; };
  canvas.addEventListener("keyup", release);
  canvas.addEventListener("blur", release);

  repaint.add(draw);
  new ResizeObserver(draw).observe(canvas);
  toy.reset(begin);
  draw();
}
