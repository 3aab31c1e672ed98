// Which plots there are.

// A line of a model, as the legend and all plots have it.
function lineOf(model, values, more = {}) {
  return { label: data.models[model].label, values, colour: colourOf(model),
    dash: dashOf(model), model, ...more };
}

function timeCharts() {
  const record = () => recordAt(clock.record);
  data.coordinates.forEach((c, j) => {
    new Plot($("plots-run"), `${c.name} against time`, () => {
      const of = record();
      return {
        x: of.t, y: `${c.name} [${c.unit}]`, last: false,
        lines: [{ label: data.truth, values: of.q[j], colour: colours.ink, width: 2 },
          ...of.runs.map((run, i) => lineOf(i, run.q[j]))],
        bands: of.runs.flatMap((run, i) => (run.band.length ? [{ model: i, colour: colourOf(i),
          low: run.band[j], high: run.band[data.coordinates.length + j] }] : [])),
      };
    }, { timed: true, height: 205 });
  });
  data.inputs.forEach((input, j) => {
    new Plot($("plots-run"), `${input.name} against time`, () => {
      const of = record();
      return {
        x: of.t, last: j === data.inputs.length - 1, y: input.unit ? `${input.name} [${input.unit}]` : input.name,
        lines: [{ label: input.name, values: of.u[j], colour: colours.input, width: 1,
          stepped: !input.hold || input.hold === "zero-order" }],
      };
    }, { timed: true, height: 130 });
  });
  data.coordinates.forEach((c, j) => {
    new Plot($("plots-error"), `Error of ${c.name} against time`, () => ({
      x: record().t, y: `${c.name} [${c.unit}]`, last: j === data.coordinates.length - 1,
      lines: record().runs.map((run, i) => lineOf(i, run.error[j])),
    }), { timed: true, height: 160 });
  });
  const [energyUnit] = data.models.map((model) => model.energyUnit).filter(Boolean);
  if ($("plots-energy"))
    new Plot($("plots-energy"), "Energy against time, at measured and at simulated states", () => ({
      x: record().t, y: `energy [${energyUnit}]`,
      lines: record().runs.flatMap((run, i) => (run.energy.length && data.models[i].energyUnit === energyUnit ? [
        lineOf(i, run.energy[0], { label: `measured, by ${data.models[i].label}`, width: 0.7, dash: undefined }),
        lineOf(i, run.energy[1]),
      ] : [])),
    }), { timed: true, height: 160 });
}

function aheadChart() {
  if (!$("plots-ahead")) return;
  data.units.forEach((unit, j) => {
    const curves = data.models.map((of) => unpacked(of.ahead[j]));
    const longest = curves.reduce((a, b) => (b.length > a.length ? b : a), []);
    new Plot($("plots-ahead"), `Error against steps ahead, ${unit}`, () => ({
      x: longest.map((_, k) => (k + 1) * data.dt), xlabel: "ahead [s]", y: `RMSE [${unit}]`,
      lines: curves.flatMap((curve, i) => (curve.length
        ? [lineOf(i, longest.map((_, k) => curve[k] ?? null))] : [])),
    }), { height: 200 });
  });
}

function residualCharts() {
  const host = $("plots-residuals"), words = $("residual-words"), choice = $("residual-model");
  if (!host) return;
  const show = () => {
    for (const plot of plots) if (plot.host === host) { plot.remove(); }
    words.replaceChildren();
    host.classList.toggle("pairs", data.models.some((m) => m.residuals.some((r) => r.cross.length)));
    const model = Number(choice?.value ?? 0), of = data.models[model].residuals;
    if (!of.length) words.append(element("p", {}, "A free run of this model diverges: no residuals."));
    for (const r of of) {
      const own = unpacked(r.own), lags = own.length - 1;
      const bars = (name, values, from, bound) => new Plot(host, name, () => ({
        x: values.map((_, k) => (k + from) * data.dt), xlabel: "lag [s]", y: `correlation, ${name}`, bound,
        lines: [{ label: "correlation", values, colour: colourOf(model), width: 1, bars: true }],
      }), { height: 170 });
      bars(r.coordinate, own, 0, r.bound);
      r.cross.forEach((c) => bars(`${r.coordinate} with ${data.inputs[c.input].name}`,
        unpacked(c.values), -lags, c.bound));
      words.append(element("p", { class: "quiet" }, `${r.coordinate}: ${r.sentence}.`));
    }
    for (const plot of plots) if (plot.host === host) plot.make();
  };
  choice?.addEventListener("change", show);
  show();
}

function trainingCharts() {
  const host = $("plots-training");
  if (!host) return;
  const power = (values) => values.map((v) => (v === null ? null : 10 ** v));
  const curves = data.models.flatMap((of, model) => of.training.map((curve) => ({
    model, name: [of.label, curve.name].filter(Boolean).join(", "), x: unpacked(curve.epoch),
    loss: power(unpacked(curve.loss)), validation: power(unpacked(curve.validation)),
  })));
  const kinds = { loss: "training loss", validation: `validation RMSE [${data.unit}]` };
  for (const [key, y] of Object.entries(kinds)) {
    const told = curves.filter((curve) => curve[key].some((v) => v !== null));
    if (!told.length) continue;
    new Plot(host, `${y} by epoch`, () => {
      const x = [...new Set(told.flatMap((curve) => curve.x))].sort((a, b) => a - b);
      return { x, xlabel: "epoch", y, lines: told.map((curve) => {
        const by = new Map(curve.x.map((epoch, k) => [epoch, curve[key][k]]));
        return lineOf(curve.model, x.map((epoch) => by.get(epoch)), { label: curve.name });
      }) };
    }, { height: 200, log: true });
  }
}

// An identification: the cost by iteration of all stages, and where the stages left the parameters.
function searchCharts() {
  const host = $("plots-search");
  if (!host) return;
  const searched = data.models.map((of, model) => ({ model, ...of.search })).filter((of) => of.stages);
  const costs = searched.map(({ model, stages }) => {
    const by = new Map(); // what each iteration came to, and its stage; nothing between stages
    let done = 0;
    for (const { name, cost } of stages) {
      if (done) by.set(done + 0.5, [null, ""]);
      for (const value of cost) by.set(++done, [value, name]);
    }
    return { model, by };
  });
  const x = [...new Set(costs.flatMap(({ by }) => [...by.keys()]))].sort((a, b) => a - b);
  new Plot(host, "Cost by iteration of all stages", () => ({
    x, xlabel: "iteration", y: "cost", whole: true,
    lines: costs.map(({ model, by }) => lineOf(model, x.map((k) => by.get(k)?.[0]), {
      dash: undefined, points: true,
      told: (v, k) => (by.get(x[k])?.[1] ? `${told(v, 4)}, ${by.get(x[k])[1]}` : "\u2013"),
    })),
  }), { height: 200, log: true, legend: true });
  const names = [...new Set(searched.flatMap((of) => of.parameters.map((p) => p.name)))];
  for (const name of names) {
    const of = searched.map(({ model, parameters }) => ({ model, ...parameters.find((p) => p.name === name) }))
      .filter((p) => p.values);
    const stages = Math.max(...of.map((p) => p.values.length)), { unit } = of[0];
    const counted = Array.from({ length: stages }, (_, k) => k + 1);
    new Plot($("plots-parameters"), `${name} after each stage`, () => ({
      x: counted, xlabel: "stage", y: unit ? `${name} [${unit}]` : name, whole: true,
      lines: of.map((p) => lineOf(p.model, counted.map((k) => p.values[k - 1] ?? null), { points: true })),
    }), { height: 130, legend: false });
  }
}
