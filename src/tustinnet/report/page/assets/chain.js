// A mechanism as a chain of rigid links in perspective.

const add = (a, b) => a.map((x, i) => x + b[i]);
const scaled = (a, k) => a.map((x) => k * x);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0],
];
const lengthOf = (a) => Math.hypot(...a);
const unitOf = (a) => scaled(a, 1 / lengthOf(a));

// A vector turned about an axis of length 1 (Rodrigues).
function turned(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), along = dot(axis, v) * (1 - c);
  const side = cross(axis, v);
  return v.map((x, i) => x * c + side[i] * s + axis[i] * along);
}

const SPARE = 0.4; // rad, beyond what an angle reaches

class Chain {
  // ends: of each coordinate, what records reach; whole: room for turns beyond that
  constructor(links, coordinates, ends, whole = false) {
    this.coordinates = coordinates;
    this.links = links.map((of) => ({ ...of, axis: unitOf(of.axis),
      slides: coordinates[of.coordinate].kind === "linear" }));
    this.travel = ends;
    this.swept = ends.map(([low, high], i) => (coordinates[i].kind === "linear" ? [low, high]
      : whole || high - low > TURN - 2 * SPARE ? [0, TURN] : [low - SPARE, high + SPARE]));
    const reach = this.links.reduce((sum, of) => sum + lengthOf(of.reach), 0);
    const slides = this.links.filter((of) => of.slides);
    const span = slides.map((of) => ends[of.coordinate][1] - ends[of.coordinate][0]);
    this.size = Math.max(reach, 0.6 * Math.max(0, ...span), 1e-6);
    // what only moves in the plane of the screen is looked at from straight ahead
    this.flat = this.links.every((of) => (of.slides ? Math.abs(of.axis[1]) < 1e-6
      : Math.abs(of.axis[1]) > 1 - 1e-6) && Math.abs(of.reach[1]) < 1e-9);
    this.azimuth = this.flat ? 0 : 0.5;
    this.elevation = this.flat ? 0 : 0.36;
    this.middle = slides.map((of, i) => scaled(of.axis,
      (ends[of.coordinate][0] + ends[of.coordinate][1]) / 2)).reduce(add, [0, 0, 0]);
    this.upright = !this.flat && !this.links[0].slides && Math.abs(this.links[0].axis[2]) > 0.9;
    this.box = this.reached();
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
      for (const joint of this.joints(q)) points.push(see(joint));
    }
    if (this.upright) points.push(see([0, 0, -1.2 * lengthOf(this.links[0].reach)]));
    const spare = 0.08 * this.size;
    return [0, 1].map((i) => {
      const [low, high] = endsOf([points.map((p) => p[i])]);
      return [low - spare, high + spare];
    });
  }

  // The joints, from the first one to the chain's end.
  joints(q) {
    let place = [0, 0, 0];
    const places = [], turns = [];
    const carried = (v) => turns.reduceRight((of, [axis, angle]) => turned(of, axis, angle), v);
    for (const link of this.links) {
      const value = q[link.coordinate];
      if (link.slides) place = add(place, scaled(carried(link.axis), value));
      places.push(place);
      if (!link.slides) turns.push([link.axis, value]);
      place = add(place, carried(link.reach));
    }
    return [...places, place];
  }

  // Where points are on a screen of some size, and how large things are there.
  camera(width, height) {
    const see = this.seen(), [[left, right], [top, bottom]] = this.box;
    const scale = Math.min(width / (right - left), height / (bottom - top), 0.5 * width / this.size);
    return (point) => {
      const [x, y, k] = see(point);
      return [width / 2 + scale * (x - (left + right) / 2), height / 2 + scale * (y - (top + bottom) / 2), k];
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
    context.fillStyle = faint(colours.line, 0.35);
    context.lineWidth = 1;
    if (this.upright) {
      const around = lengthOf(this.links[0].reach), floor = -1.2 * around;
      context.setLineDash([2, 5]);
      context.beginPath();
      for (let i = 0; i <= 48; i++) {
        const a = (TURN * i) / 48, p = see([around * Math.cos(a), around * Math.sin(a), 0]);
        if (i) context.lineTo(p[0], p[1]); else context.moveTo(p[0], p[1]);
      }
      context.stroke();
      context.setLineDash([]);
      this.block(context, see, 0.42 * around, floor, -0.1 * around);
    }
    for (const link of this.links.filter((of) => of.slides).slice(0, 1)) {
      const [low, high] = this.travel[link.coordinate], spare = 0.12 * (high - low) + 0.05 * this.size;
      const rail = [low - spare, high + spare].map((x) => see(scaled(link.axis, x)));
      context.lineWidth = 3;
      context.beginPath();
      context.moveTo(rail[0][0], rail[0][1]);
      context.lineTo(rail[1][0], rail[1][1]);
      context.stroke();
    }
    if (!this.upright && !this.links[0].slides) {
      const [x, y] = see([0, 0, 0]);
      context.strokeStyle = colours.grey;
      context.beginPath();
      context.moveTo(x - 26, y);
      context.lineTo(x + 26, y);
      for (let i = -24; i <= 24; i += 8) { context.moveTo(x + i, y); context.lineTo(x + i + 7, y - 7); }
      context.stroke();
    }
    context.restore();
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
      context.beginPath();
      corners.forEach(([x, y, z], k) => {
        const p = at(x, y, z);
        if (k) context.lineTo(p[0], p[1]); else context.moveTo(p[0], p[1]);
      });
      context.closePath();
      context.fillStyle = colours.paper;
      context.fill();
      context.fillStyle = faint(colours.ink, [0.07, 0.12, 0.03][i]);
      context.fill();
      context.stroke();
    });
    const [a, b] = [see([0, 0, high]), see([0, 0, 0])];
    context.lineWidth = 5;
    context.strokeStyle = faint(colours.ink, 0.25);
    context.beginPath();
    context.moveTo(a[0], a[1]);
    context.lineTo(b[0], b[1]);
    context.stroke();
    context.lineWidth = 1;
    context.strokeStyle = colours.line;
  }

  pose(context, see, { q, colour, dash = [], width = 3, trail = [] }) {
    context.save();
    context.lineCap = "round";
    context.lineJoin = "round";
    this.trail(context, see, trail, colour);
    context.strokeStyle = colour;
    const joints = this.joints(q).map(see);
    context.lineWidth = width;
    context.setLineDash(dash);
    for (let i = 0; i + 1 < joints.length; i++) {
      context.beginPath();
      context.moveTo(joints[i][0], joints[i][1]);
      context.lineTo(joints[i + 1][0], joints[i + 1][1]);
      context.stroke();
    }
    context.setLineDash([]);
    this.links.forEach((link, i) => {
      const [x, y, k] = joints[i], half = link.slides ? 20 * k : (width + 1.5) * k;
      context.fillStyle = colours.paper;
      context.lineWidth = Math.min(width, 2);
      context.beginPath();
      if (link.slides) context.roundRect(x - half, y - 0.6 * half, 2 * half, 1.2 * half, 3);
      else context.arc(x, y, half, 0, TURN);
      context.fill();
      context.stroke();
    });
    const end = joints[joints.length - 1], last = this.links[this.links.length - 1];
    if (lengthOf(last.reach) > 0) {
      context.fillStyle = colour;
      context.beginPath();
      context.arc(end[0], end[1], (width + 2) * end[2], 0, TURN);
      context.fill();
    }
    context.restore();
  }

  // Where the end was, fading.
  trail(context, see, trail, colour) {
    if (trail.length < 2) return;
    const points = trail.map((q) => see(this.joints(q)[this.links.length]));
    context.lineWidth = 1.5;
    context.setLineDash([]);
    for (let i = 1; i < points.length; i++) {
      context.strokeStyle = faint(colour, (0.45 * i) / points.length);
      context.beginPath();
      context.moveTo(points[i - 1][0], points[i - 1][1]);
      context.lineTo(points[i][0], points[i][1]);
      context.stroke();
    }
  }

  // The coordinate whose link is nearest to a point of the screen; null where none is near.
  near(q, x, y, width, height) {
    const joints = this.joints(q).map(this.camera(width, height));
    let best = null, least = 28;
    this.links.forEach((link, i) => {
      for (let s = link.slides ? 0 : 0.25; s <= 1; s += 0.125) {
        const [px, py] = [0, 1].map((k) => joints[i][k] + s * (joints[i + 1][k] - joints[i][k]));
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
      const joints = this.joints(moved).map(see);
      return [0, 1].map((k) => joints[taken.link][k]
        + taken.share * (joints[taken.link + 1][k] - joints[taken.link][k]));
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
