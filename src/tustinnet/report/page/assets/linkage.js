// A mechanism as a tree of rigid links in perspective, see `tustinnet.models.kinematics`.

const add = (a, b) => a.map((x, i) => x + b[i]);
const scaled = (a, k) => a.map((x) => k * x);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const lengthOf = (a) => Math.hypot(...a);
const unitOf = (a) => scaled(a, 1 / lengthOf(a));

// A rotation is three vectors: where it takes those of the axes.
const STILL = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
const carried = ([x, y, z], v) => [0, 1, 2].map((i) => x[i] * v[0] + y[i] * v[1] + z[i] * v[2]);

// A vector turned about an axis of length 1 (Rodrigues).
function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), along = dot(axis, v) * (1 - c);
  const side = cross(axis, v);
  return v.map((x, i) => x * c + side[i] * s + axis[i] * along);
}

// Whether a point lies on the line from the origin to another one.
function between(point, end) {
  const share = Math.min(Math.max(dot(point, end) / (dot(end, end) || 1), 0), 1);
  return lengthOf(add(point, scaled(end, -share))) < 1e-6;
}

// A path through points of the screen.
function path(context, points) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y); // the first one moves there
}

function line(context, ...points) {
  path(context, points);
  context.stroke();
}

const SPARE = 0.4; // rad, beyond what an angle reaches
const RIM = 24; // corners of a wheel, a multiple of 8
const STEPS = 8; // in which a trail fades

class Linkage {
  // ends: of each coordinate, what records reach; whole: room for turns beyond that
  constructor(links, coordinates, ends, whole = false) {
    this.coordinates = coordinates;
    this.travel = ends;
    this.swept = ends.map(([low, high], i) => (coordinates[i].kind === "linear" ? [low, high]
      : whole || high - low > TURN - 2 * SPARE ? [0, TURN] : [low - SPARE, high + SPARE]));
    this.links = links.map((of) => ({ ...of, axis: unitOf(of.axis), long: lengthOf(of.reach) > 0,
      slides: coordinates[of.coordinate].kind === "linear" }));
    this.links.forEach((of) => {
      of.origin = of.at ?? (of.parent === null ? [0, 0, 0] : links[of.parent].reach);
      of.branch = of.parent !== null && of.at && !between(of.at, links[of.parent].reach);
    });
    this.roots = this.links.filter((of) => of.parent === null);
    // the end of a wheel is no tip: its trail would only be circles
    const parents = new Set(links.filter((of) => of.shape !== "wheel").map((of) => of.parent));
    this.tips = [...links.keys()].filter((i) => !parents.has(i) && links[i].shape !== "wheel");
    this.look(ends);
    this.box = this.reached();
  }

  // From where it is looked at, and how large it is.
  look(ends) {
    const slides = this.links.filter((of) => of.slides);
    const span = slides.map((of) => ends[of.coordinate][1] - ends[of.coordinate][0]), far = [];
    this.links.forEach((of, i) => {
      far[i] = (of.parent === null ? 0 : far[of.parent]) + lengthOf(of.origin);
    });
    const reach = this.links.map((of, i) => far[i] + lengthOf(of.reach));
    this.size = Math.max(...reach, 0.6 * Math.max(0, ...span), 1e-6);
    // what only moves in the plane of the screen is looked at from straight ahead
    this.flat = this.links.every((of) => (of.slides ? Math.abs(of.axis[1]) < 1e-6
      : Math.abs(of.axis[1]) > 1 - 1e-6) && Math.abs(of.reach[1]) + Math.abs(of.origin[1]) < 1e-9);
    this.azimuth = this.flat ? 0 : 0.5;
    this.elevation = this.flat ? 0 : 0.36;
    const begin = scaled(this.roots.map((of) => of.origin).reduce(add), 1 / this.roots.length);
    this.middle = slides.map((of) => scaled(of.axis,
      (ends[of.coordinate][0] + ends[of.coordinate][1]) / 2)).reduce(add, begin);
    this.towers = this.flat ? [] : this.roots.filter((of) => !of.slides && Math.abs(of.axis[2]) > 0.9);
  }

  // The smallest box of the screen that all positions fit into, at a scale of 1: [low, high] each.
  reached() {
    const see = this.seen(), points = [];
    const turns = this.links.map((of) => (of.slides ? 2 : Math.min(17, Math.round(900 ** (1 / this.links.length)))));
    const count = turns.reduce((a, b) => a * b, 1);
    for (let k = 0; k < Math.min(count, 4000); k++) {
      const q = this.coordinates.map(() => 0);
      let rest = k;
      this.links.forEach((of, i) => {
        const step = rest % turns[i], [low, high] = this.swept[of.coordinate];
        rest = Math.floor(rest / turns[i]);
        q[of.coordinate] = low + ((high - low) * step) / (turns[i] - 1 || 1);
      });
      this.places(q).forEach((place, i) => {
        points.push(see(place.origin), ...this.outline(this.links[i], place).map(see));
      });
    }
    for (const of of this.roots) if (of.slides) points.push(...this.railEnds(of, of.origin, STILL).map(see));
    for (const of of this.towers) points.push(see(add(of.origin, [0, 0, -1.2 * this.around(of)])));
    const spare = 0.08 * this.size;
    return [0, 1].map((i) => {
      const [low, high] = endsOf([points.map((p) => p[i])]);
      return [low - spare, high + spare];
    });
  }

  // How far a link reaches around its joint.
  around(link) { return lengthOf(link.reach) || 0.3 * this.size; }

  // Points around a link.
  outline(link, { begin, end, before }) {
    const arm = add(end, scaled(begin, -1));
    if (link.shape === "beam") return [add(begin, scaled(arm, -1)), end];
    if (link.shape === "wheel") {
      const axis = carried(before, link.axis);
      return Array.from({ length: RIM }, (_, i) => add(begin, turned(arm, axis, (TURN * i) / RIM)));
    }
    if (link.shape === "ball") return STILL.flatMap((axis) => [-1, 1].map(
      (side) => add(end, scaled(axis, side * lengthOf(arm)))));
    return [begin, end];
  }

  // Of every link where it is: the place of its joint at 0, its beginning, its end; its rotation and
  // that of what carries it.
  places(q) {
    const found = [];
    for (const link of this.links) {
      const under = link.parent === null ? null : found[link.parent], value = q[link.coordinate];
      const before = under ? under.rotation : STILL;
      const origin = under ? add(under.begin, carried(before, link.origin)) : link.origin;
      const begin = link.slides ? add(origin, scaled(carried(before, link.axis), value)) : origin;
      const rotation = link.slides ? before
        : STILL.map((axis) => carried(before, turned(axis, link.axis, value)));
      found.push({ origin, begin, before, rotation, end: add(begin, carried(rotation, link.reach)) });
    }
    return found;
  }

  // Where the tips of all branches are.
  ends(q) {
    const places = this.places(q);
    return this.tips.map((i) => places[i].end);
  }

  // Where points are on a screen of some size, how large things are there, and pixels of a metre.
  camera(width, height) {
    const see = this.seen(), [[left, right], [top, bottom]] = this.box;
    const scale = Math.min(width / (right - left), height / (bottom - top), 0.5 * width / this.size);
    return (point) => {
      const [x, y, k] = see(point);
      return [width / 2 + scale * (x - (left + right) / 2), height / 2 + scale * (y - (top + bottom) / 2),
        k, scale * k];
    };
  }

  // The same at a scale of 1, about the first joint.
  seen() {
    const far = 4.2 * this.size;
    const [ca, sa] = [Math.cos(this.azimuth), Math.sin(this.azimuth)];
    const [ce, se] = [Math.cos(this.elevation), Math.sin(this.elevation)];
    return (point) => {
      const [x, y, z] = add(point, scaled(this.middle, -1));
      const right = ca * x + sa * y, away = -sa * x + ca * y;
      const depth = ce * away - se * z, up = se * away + ce * z;
      const k = this.flat ? 1 : far / (far + depth);
      return [k * right, -k * up, k];
    };
  }

  draw(context, width, height, poses) {
    const see = this.camera(width, height);
    this.ground(context, see);
    for (const pose of poses) this.pose(context, see, pose);
  }

  ground(context, see) {
    context.save();
    context.strokeStyle = colours.line;
    context.lineWidth = 1;
    for (const of of this.towers) this.tower(context, see, of);
    const shafts = this.shafts(), onShafts = new Set(shafts.flat());
    for (const of of this.roots) {
      if (of.slides) this.rail(context, see, of, of.origin, STILL, 3);
      else if (!this.towers.includes(of) && !onShafts.has(of))
        this.support(context, see(of.origin), ["beam", "wheel"].includes(of.shape));
    }
    for (const [one, other] of shafts) {
      this.support(context, see(scaled(add(one.origin, other.origin), 0.5)), true);
      context.lineWidth = 4;
      line(context, see(one.origin), see(other.origin));
    }
    context.restore();
  }

  // The ground above a joint that something hangs from, or below what stands on it.
  support(context, [x, y], stands) {
    const low = stands ? y + 24 : y, side = stands ? 1 : -1;
    context.strokeStyle = colours.grey;
    context.lineWidth = 1;
    if (stands) line(context, [x - 13, low], [x, y], [x + 13, low]);
    line(context, [x - 26, low], [x + 26, low]);
    for (let i = -24; i <= 24; i += 8) line(context, [x + i, low], [x + i - 7 * side, low + 7 * side]);
  }

  // Wheels on the base that turn about one line, by twos: a shaft is between them.
  shafts() {
    const wheels = this.roots.filter((of) => of.shape === "wheel");
    return wheels.flatMap((of, i) => wheels.slice(0, i).map((other) => [other, of])).filter((pair) => {
      const along = add(pair[1].origin, scaled(pair[0].origin, -1)), long = lengthOf(along);
      return pair.every(({ axis }) => lengthOf(cross(axis, along)) <= 1e-6 * long);
    });
  }

  // What a link slides along, in the frame of what carries it.
  rail(context, see, link, origin, rotation, width) {
    if (link.shape === "ball") return; // it rolls on what carries it
    context.lineWidth = width;
    line(context, ...this.railEnds(link, origin, rotation).map(see));
  }

  railEnds(link, origin, rotation) {
    const [low, high] = this.travel[link.coordinate], spare = 0.12 * (high - low) + 0.05 * this.size;
    const axis = carried(rotation, link.axis);
    return [low - spare, high + spare].map((x) => add(origin, scaled(axis, x)));
  }

  // A spring between the end of a rail, a wall, and what slides on it.
  spring(context, see, link, { origin, begin, before }) {
    const [[x0, y0], [x1, y1]] = [this.railEnds(link, origin, before)[0], begin].map(see);
    const long = Math.hypot(x1 - x0, y1 - y0) || 1, [ax, ay] = [(x1 - x0) / long, (y1 - y0) / long];
    const at = (share, side) => [x0 + share * (x1 - x0) - side * ay, y0 + share * (y1 - y0) + side * ax];
    const turns = 9, coil = Array.from({ length: 2 * turns }, (_, i) =>
      at(0.06 + (0.86 * (i + 0.5)) / (2 * turns), i % 2 ? -9 : 9));
    line(context, at(0, 0), at(0.06, 0), ...coil, at(0.92, 0), at(1, 0));
    line(context, at(0, -26), at(0, 26));
  }

  // What a link looks like between its joint and its end, in the colour and width of its pose.
  body(context, see, link, place, width) {
    const { begin, end, rotation } = place;
    if (link.shape === "spring") {
      context.lineWidth = Math.min(width, 1.5);
      this.spring(context, see, link, place);
      context.lineWidth = width;
    }
    if (!link.long || link.shape === "ball") return;
    if (link.shape === "rope") context.lineWidth = Math.min(width, 1.5);
    const outline = this.outline(link, place);
    if (link.shape === "wheel") { // a rim, and spokes that show how it turns
      line(context, ...outline.map(see), see(end));
      for (let i = 0; i < RIM / 2; i += RIM / 4) line(context, see(outline[i]), see(outline[i + RIM / 2]));
    } else line(context, ...outline.map(see));
    context.lineWidth = width;
    if (link.shape === "propeller") { // it blows across the link
      const axis = carried(place.before, link.axis), arm = carried(rotation, link.reach);
      const hub = add(end, scaled(cross(arm, axis), 0.08));
      line(context, see(end), see(hub));
      line(context, ...[-0.22, 0.22].map((share) => see(add(hub, scaled(arm, share)))));
    }
  }

  // The circle that a link runs around an upright joint, on its housing.
  tower(context, see, link) {
    const around = this.around(link);
    context.setLineDash([2, 5]);
    line(context, ...Array.from({ length: 49 }, (_, i) => {
      const a = (TURN * i) / 48;
      return see(add(link.origin, [around * Math.cos(a), around * Math.sin(a), 0]));
    }));
    context.setLineDash([]);
    const on = (point) => see(add(link.origin, point));
    this.block(context, on, 0.42 * around, -1.2 * around, -0.1 * around);
  }

  // A housing below the first joint.
  block(context, see, half, low, high) {
    const at = (x, y, z) => see([half * x, half * y, z]);
    const faces = [
      [[-1, -1, low], [1, -1, low], [1, -1, high], [-1, -1, high]],
      [[1, -1, low], [1, 1, low], [1, 1, high], [1, -1, high]],
      [[-1, -1, high], [1, -1, high], [1, 1, high], [-1, 1, high]],
    ];
    faces.forEach((corners, i) => {
      path(context, corners.map(([x, y, z]) => at(x, y, z)));
      context.closePath();
      context.fillStyle = colours.paper;
      context.fill();
      context.fillStyle = faint(colours.ink, [0.07, 0.12, 0.03][i]);
      context.fill();
      context.stroke();
    });
    context.lineWidth = 5;
    context.strokeStyle = faint(colours.ink, 0.25);
    line(context, see([0, 0, high]), see([0, 0, 0]));
    context.lineWidth = 1;
    context.strokeStyle = colours.line;
  }

  pose(context, see, { q, colour, dash = [], width = 3, trail = [] }) {
    context.save();
    context.lineCap = "round";
    context.lineJoin = "round";
    this.trail(context, see, trail, colour);
    context.strokeStyle = colour;
    const places = this.places(q);
    this.links.forEach((link, i) => {
      if (link.slides && link.parent !== null) {
        context.globalAlpha = 0.35;
        this.rail(context, see, link, places[i].origin, places[i].before, 1.5);
        context.globalAlpha = 1;
      }
    });
    context.lineWidth = width;
    context.setLineDash(dash);
    this.links.forEach((link, i) => {
      if (link.branch) line(context, see(places[link.parent].begin), see(places[i].origin));
      this.body(context, see, link, places[i], width);
    });
    context.setLineDash([]);
    this.links.forEach((link, i) => {
      const ball = link.shape === "ball", [x, y, k, metre] = see(ball ? places[i].end : places[i].begin);
      const half = ball ? lengthOf(link.reach) * metre : link.slides ? 20 * k : (width + 1.5) * k;
      context.fillStyle = colours.paper;
      context.lineWidth = Math.min(width, 2);
      context.beginPath();
      if (link.slides && !ball) context.roundRect(x - half, y - 0.6 * half, 2 * half, 1.2 * half, 3);
      else context.arc(x, y, half, 0, TURN);
      context.fill();
      context.stroke();
    });
    context.fillStyle = colour;
    for (const i of this.tips.filter((tip) => this.links[tip].long && this.links[tip].shape !== "ball")) {
      const [x, y, k] = see(places[i].end), load = this.links[i].shape === "rope" ? 6 : 0;
      context.beginPath();
      context.arc(x, y, (width + 2 + load) * k, 0, TURN);
      context.fill();
    }
    context.restore();
  }

  // Where the tips were, fading: a line in steps, as each costs a stroke.
  trail(context, see, trail, colour) {
    if (trail.length < 2) return;
    context.lineWidth = 1.5;
    context.setLineDash([]);
    const steps = Math.min(STEPS, trail.length - 1);
    this.tips.forEach((_, tip) => {
      const points = trail.map((ends) => see(ends[tip]));
      for (let k = 0; k < steps; k++) {
        const [from, to] = [k, k + 1].map((i) => Math.round((i * (points.length - 1)) / steps));
        context.strokeStyle = faint(colour, (0.45 * (k + 0.5)) / steps);
        line(context, ...points.slice(from, to + 1));
      }
    });
  }

  // The coordinate whose link is nearest to a point of the screen; null where none is near.
  near(q, x, y, width, height) {
    const see = this.camera(width, height);
    const places = this.places(q).map(({ begin, end }) => [see(begin), see(end)]);
    let best = null, least = 28;
    this.links.forEach((link, i) => {
      for (let s = link.slides ? 0 : 0.25; s <= 1; s += 0.125) {
        const [px, py] = [0, 1].map((k) => places[i][0][k] + s * (places[i][1][k] - places[i][0][k]));
        const away = Math.hypot(px - x, py - y);
        if (away < least) { least = away; best = { coordinate: link.coordinate, link: i, share: s }; }
      }
    });
    return best;
  }

  // The value of a coordinate at which the point that was taken is nearest to a point of the screen.
  pulled(q, taken, x, y, width, height) {
    const see = this.camera(width, height), moved = [...q];
    const where = (value) => {
      moved[taken.coordinate] = value;
      const { begin, end } = this.places(moved)[taken.link], [from, to] = [see(begin), see(end)];
      return [0, 1].map((k) => from[k] + taken.share * (to[k] - from[k]));
    };
    const slides = this.links[taken.link].slides, most = slides ? this.size : 0.6;
    let value = q[taken.coordinate];
    for (let turn = 0; turn < 6; turn++) { // Gauss-Newton, with short steps
      const h = slides ? 1e-4 * this.size : 1e-4, p = where(value), next = where(value + h);
      const slope = [0, 1].map((k) => (next[k] - p[k]) / h);
      const square = slope[0] ** 2 + slope[1] ** 2 + 30;
      const step = (slope[0] * (x - p[0]) + slope[1] * (y - p[1])) / square;
      value += Math.min(Math.max(step, -most), most);
    }
    return value;
  }
}
