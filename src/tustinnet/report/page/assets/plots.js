// One plot: lines with dashes, a legend with values, zoom by mouse and keys, a line for now.

const plots = new Set();
const WHOLE = { min: null, max: null };
let zoomed = WHOLE; // of all time plots together

function axis(label, more = {}) {
  return {
    label, labelSize: 16, labelGap: 2, size: 48, gap: 4, stroke: colours.quiet,
    font: "11px system-ui, sans-serif", labelFont: "11px system-ui, sans-serif",
    grid: { stroke: colours.line, width: 1 }, ticks: { stroke: colours.line, width: 1, size: 4 },
    ...more,
  };
}

// The ends of an axis about values, which a bound belongs to; room where nothing changes.
function roomy(low, high, bound) {
  if (low === null || low === undefined) return [-1, 1];
  const ends = bound ? [Math.min(low, -1.3 * bound), Math.max(high, 1.3 * bound)] : [low, high];
  const spare = ends[1] > ends[0] ? 0.07 * (ends[1] - ends[0]) : Math.abs(low) || 1;
  return [ends[0] - spare, ends[1] + spare];
}

// A number at an axis, where there is little room.
function shortly(v) {
  const text = told(v);
  return text.length > 6 && v !== 0 && Math.abs(v) < 0.01 ? Number(v.toPrecision(3)).toExponential() : text;
}

// Pixels from tick to tick of an axis of values, so few that a low plot has two ticks at least: from
// one step of ticks to the next, as from 5 to 10, is a factor of 2 at most.
const tickSpace = (u, i, low, high, pixels) => Math.min(26, pixels / 4);

// Powers of ten on an axis, few of them.
function powers(u, i, low, high) {
  const [from, to] = [Math.ceil(Math.log10(low)), Math.floor(Math.log10(high))];
  const step = Math.max(1, Math.ceil((to - from) / 5)), found = [];
  for (let k = from; k <= to; k += step) found.push(10 ** k);
  return found.length ? found : [low, high];
}

class Plot {
  // of: what is drawn, made anew for each record: { x, lines: [{ label, values, colour, dash,
  // width, model, stepped, bars, points, told }], bands: [{ low, high, colour }], y, xlabel, bound,
  // last, whole }
  constructor(host, name, of, { timed = false, height = 150, log = false, legend = null } = {}) {
    Object.assign(this, { host, name, of, timed, height, log, legend, drawn: null });
    this.frame = host.appendChild(element("div", {
      class: "plot", tabindex: "0", role: "group", "aria-label": name,
    }));
    this.frame.addEventListener("keydown", (event) => this.key(event));
    plots.add(this);
    this.watch = new ResizeObserver(() => this.fit());
    this.watch.observe(this.frame);
    this.seen = true;
    this.look = new IntersectionObserver((all) => {
      this.seen = all.at(-1).isIntersecting;
      if (this.seen) this.mark(clock.time, true);
    });
    if (timed) this.look.observe(this.frame);
  }

  make() {
    this.drawn?.destroy();
    const told_ = this.of();
    this.frame.hidden = !told_;
    this.drawn = null;
    this.frame.replaceChildren();
    if (!told_) return;
    const { x, lines, bands = [], y, xlabel = "time [s]", bound, last = true, whole = false } = told_;
    const visible = shown();
    this.frame.append(element("p", { class: "what" }, y));
    const series = [{ label: xlabel, value: (u, v) => (v === null || v === undefined ? "\u2013" : String(Number(v.toFixed(3)))) }];
    const values = [x];
    for (const line of lines) {
      series.push({
        label: line.label, stroke: line.colour, width: line.width ?? 1.5, dash: line.dash,
        points: { show: Boolean(line.points), size: 4, fill: line.colour },
        value: (u, v, i, k) => (line.told ? line.told(v, k) : told(v)),
        show: line.model === undefined || visible[line.model],
        paths: line.bars ? uPlot.paths.bars({ size: [0.7, 6], align: 0 })
          : line.stepped ? uPlot.paths.stepped({ align: 1 }) : undefined,
        fill: line.bars ? line.colour : undefined,
      });
      values.push(line.values);
    }
    const shaded = [];
    for (const band of bands) {
      if (!visible[band.model]) continue;
      for (const end of [band.high, band.low]) {
        series.push({ label: "", stroke: "transparent", points: { show: false }, class: "silent" });
        values.push(end);
      }
      shaded.push({ series: [series.length - 2, series.length - 1], fill: faint(band.colour, 0.16) });
    }
    this.drawn = new uPlot({
      width: Math.max(this.frame.clientWidth, 200), height: this.height, series, bands: shaded,
      cursor: { drag: { x: true, y: false, dist: 6 }, focus: { prox: 1e6 }, points: { size: 5 } },
      focus: { alpha: 1 },
      legend: { show: this.legend ?? (lines.length > 1 || this.timed), live: true, markers: { width: 2, dash: (u, i) => (series[i].dash ? "dashed" : "solid") } },
      scales: {
        x: { time: false, ...(this.timed && zoomed.min !== null ? { range: [zoomed.min, zoomed.max] } : {}) },
        y: this.log ? { distr: 3 } : { range: (u, low, high) => roomy(low, high, bound) },
      },
      axes: [last ? axis(xlabel, { size: 26, labelSize: 15, labelGap: 0, space: whole ? 24 : 60,
        ...(whole ? { incrs: [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000] } : {}) }) : axis(undefined, { size: 24, space: 60 }),
        axis(undefined, { size: whole ? 54 : 46, space: tickSpace, ...(this.log ? { splits: powers } : {}), values: (u, ticks) => ticks.map((v) => (v === null ? "" : shortly(v))) })],
      hooks: {
        drawAxes: bound ? [(u) => this.shade(u, bound)] : [],
        ready: [(u) => { if (!this.timed && (this.legend ?? lines.length > 1)) u.setLegend({ idx: x.length - 1 }); }],
        setScale: [(u, scale) => this.scaled(u, scale)],
      },
    }, values, this.frame);
    if (this.timed) {
      this.now = this.drawn.over.appendChild(element("div", { class: "now" }));
      this.drawn.over.addEventListener("click", (event) => {
        if (this.dragged) { this.dragged = false; return; }
        clock.go(this.drawn.posToVal(event.offsetX, "x"));
      });
      this.mark(clock.time, true);
    }
  }

  remove() {
    this.drawn?.destroy();
    this.watch.disconnect();
    this.look.disconnect();
    this.frame.remove();
    plots.delete(this);
  }

  shade(u, bound) {
    const [a, b] = [bound, -bound].map((v) => u.valToPos(v, "y", true));
    u.ctx.save();
    u.ctx.fillStyle = colours.band;
    const top = Math.max(a, u.bbox.top), bottom = Math.min(b, u.bbox.top + u.bbox.height);
    u.ctx.fillRect(u.bbox.left, top, u.bbox.width, bottom - top);
    u.ctx.restore();
  }

  // Every time plot shows the same stretch.
  scaled(u, scale) {
    if (!this.timed || scale !== "x" || !this.drawn || Plot.busy) return;
    const { min, max } = u.scales.x;
    this.dragged = true;
    setTimeout(() => { this.dragged = false; }, 50);
    zoom(min, max, this);
  }

  fit() {
    const width = this.frame.clientWidth;
    if (this.drawn && width > 0 && width !== this.drawn.width)
      this.drawn.setSize({ width, height: this.height });
    if (this.timed && this.drawn) this.mark(clock.time, false);
  }

  // The line for now; values in the legend now and then, which costs more.
  mark(time, values) {
    if (!this.drawn || !this.now) return;
    const left = this.drawn.valToPos(time, "x"), { bbox } = this.drawn;
    this.now.style.transform = `translateX(${left}px)`;
    const hidden = !(left >= 0 && left <= bbox.width / uPlot.pxRatio);
    if (this.now.hidden !== hidden) this.now.hidden = hidden;
    if (values && this.drawn.cursor.left < 0)
      this.drawn.setLegend({ idx: placeIn(this.drawn.data[0], time) });
  }

  key(event) {
    const by = { "+": 0.5, "=": 0.5, "-": 2, "0": null }[event.key];
    if (by === undefined || !this.timed) {
      if (this.timed && (event.key === "ArrowLeft" || event.key === "ArrowRight")) {
        clock.pause();
        clock.go(clock.time + (event.key === "ArrowRight" ? 1 : -1) * 0.01 * clock.length);
        event.preventDefault();
      }
      return;
    }
    zoomBy(by);
    event.preventDefault();
  }
}

function zoom(min, max, except = null) {
  const whole = min <= 0 && max >= clock.length;
  zoomed = min === null || whole ? WHOLE : { min, max };
  const ends = zoomed.min === null ? { min: 0, max: clock.length } : zoomed;
  Plot.busy = true;
  for (const plot of plots)
    if (plot.timed && plot.drawn) {
      if (plot !== except) plot.drawn.setScale("x", ends);
      plot.mark(clock.time, false);
    }
  Plot.busy = false;
}

// Closer or farther about now; null for the whole record.
function zoomBy(by) {
  if (by === null) { zoom(0, clock.length); return; }
  const { min, max } = zoomed.min === null ? { min: 0, max: clock.length } : zoomed;
  const span = Math.min((max - min) * by, clock.length);
  const low = Math.min(Math.max(clock.time - span / 2, 0), clock.length - span);
  zoom(low, low + span);
}

function beginPlots() {
  const all = () => { for (const plot of plots) plot.make(); };
  repaint.add(all);
  clock.choosers.add(() => { zoomed = WHOLE; for (const plot of plots) if (plot.timed) plot.make(); });
  let last = 0;
  clock.listeners.add((time) => {
    const due = !clock.playing || performance.now() - last > SELDOM;
    if (due) last = performance.now();
    for (const plot of plots) if (plot.timed && (plot.seen || !clock.playing)) plot.mark(time, due);
  });
  for (const box of document.querySelectorAll(".shown")) box.addEventListener("change", all);
  $("zoom-in").addEventListener("click", () => zoomBy(0.5));
  $("zoom-out").addEventListener("click", () => zoomBy(2));
  $("zoom-all").addEventListener("click", () => zoomBy(null));
  all();
}
