// Where a state leaves what was recorded, by the numbers and rules of `tustinnet.simulate.range`.

const MARGIN = 0.1; // of the recorded span, beyond which a value counts as outside
const LEAST = 1e-9; // span of what never moved

// Linear positions, sine and cosine of angles, velocities, inputs: what the points of a cloud are.
function featuresOf(angular, q, v, u) {
  const angles = q.filter((_, i) => angular[i]);
  return [...q.filter((_, i) => !angular[i]), ...angles.map(Math.sin), ...angles.map(Math.cos), ...v, ...u];
}

// How far the nearest point of a cloud is, in times of how far records are from one another.
function distanceTo({ points, spread, reach }, features) {
  const at = features.map((x, i) => x / spread[i]);
  let least = Infinity;
  for (const point of points) {
    let sum = 0;
    for (let i = 0; i < at.length && sum < least; i++) sum += (at[i] - point[i]) ** 2;
    if (sum < least) least = sum;
  }
  return Math.sqrt(least) / reach;
}

// What is outside: `by`, the places of velocities, inputs and linear positions in [q, v, u] that are
// beyond the recorded ones; `together`, whether all of it did not come together in any record.
function leaving(range, cloud, angular, q, v, u) {
  const values = [...q, ...v, ...u], ends = [...range.q, ...range.v, ...range.u], by = [];
  values.forEach((x, i) => {
    if (angular[i]) return; // angles may turn on
    const [low, high] = ends[i], beyond = Math.max(low - x, x - high) / Math.max(high - low, LEAST);
    if (!(beyond <= MARGIN)) by.push(i); // also what is no number
  });
  const together = Boolean(cloud) && values.every(Number.isFinite)
    && distanceTo(cloud, featuresOf(angular, q, v, u)) > 1;
  return { by, together };
}
