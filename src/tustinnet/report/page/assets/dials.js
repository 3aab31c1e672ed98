// A mechanism of unknown shape: a dial for every angle, a slide for every length.

class Dials {
  constructor(coordinates, ends) {
    this.coordinates = coordinates;
    this.travel = ends;
  }

  places(width, height) {
    const n = this.coordinates.length, columns = Math.min(n, Math.max(1, Math.round(width / 220)));
    const rows = Math.ceil(n / columns), w = width / columns, h = height / rows;
    return this.coordinates.map((of, i) => ({
      of, x: (i % columns + 0.5) * w, y: (Math.floor(i / columns) + 0.5) * h - 6,
      r: Math.min(w * 0.38, h * 0.36), ends: this.travel[i],
    }));
  }

  ends() { return []; } // nothing leaves a trail

  draw(context, width, height, poses) {
    const places = this.places(width, height);
    for (const place of places) this.scale(context, place);
    for (const pose of poses) places.forEach((place, i) => this.hand(context, place, pose, pose.q[i]));
  }

  scale(context, { of, x, y, r }) {
    context.save();
    context.strokeStyle = colours.line;
    context.fillStyle = colours.quiet;
    context.font = "12px system-ui, sans-serif";
    context.textAlign = "center";
    context.beginPath();
    if (of.kind === "angular") {
      context.arc(x, y, r, 0, TURN);
      for (let i = 0; i < 12; i++) {
        const a = (TURN * i) / 12, from = i % 3 ? 0.95 : 0.9;
        context.moveTo(x + from * r * Math.cos(a), y + from * r * Math.sin(a));
        context.lineTo(x + r * Math.cos(a), y + r * Math.sin(a));
      }
      context.fillText("0", x + r + 9, y + 4);
    } else {
      context.moveTo(x - r, y);
      context.lineTo(x + r, y);
      for (let i = 0; i <= 4; i++) {
        context.moveTo(x + r * (i / 2 - 1), y - 5);
        context.lineTo(x + r * (i / 2 - 1), y + 5);
      }
    }
    context.stroke();
    context.fillText(`${of.name} [${of.unit}]`, x, y + (of.kind === "angular" ? r : 24) + 20);
    context.restore();
  }

  hand(context, { of, x, y, r, ends }, { colour, dash = [], width = 3 }, value) {
    context.save();
    context.strokeStyle = context.fillStyle = colour;
    context.lineWidth = width;
    context.lineCap = "round";
    context.setLineDash(dash);
    context.beginPath();
    if (of.kind === "angular") {
      const [px, py] = [x + 0.86 * r * Math.cos(value), y - 0.86 * r * Math.sin(value)];
      context.moveTo(x, y);
      context.lineTo(px, py);
      context.stroke();
      context.beginPath();
      context.arc(px, py, width + 1, 0, TURN);
      context.fill();
    } else {
      const px = x + r * share(value, ends);
      context.roundRect(px - 10, y - 13, 20, 26, 4);
      context.globalAlpha = 0.15;
      context.fill();
      context.globalAlpha = 1;
      context.stroke();
    }
    context.restore();
  }

  near(q, x, y, width, height) {
    const i = this.places(width, height).findIndex((p) => Math.hypot(p.x - x, p.y - y) < p.r + 14);
    return i < 0 ? null : { coordinate: i };
  }

  pulled(q, taken, x, y, width, height) {
    const p = this.places(width, height)[taken.coordinate];
    if (p.of.kind === "linear") {
      const [low, high] = p.ends, to = Math.min(Math.max((x - p.x) / p.r, -1), 1);
      return (low + high) / 2 + (to * (high - low)) / 2;
    }
    const now = q[taken.coordinate];
    return now + wrapped(Math.atan2(p.y - y, x - p.x) - now);
  }
}

// Where a value stands between ends, -1..1.
function share(value, [low, high]) {
  return high > low ? Math.min(Math.max((2 * (value - low)) / (high - low) - 1, -1.1), 1.1) : 0;
}
