// The path in several levels of detail. Each level leaves out points of the one before that its other points show
// within its tolerance, by the method of cnc/view/kernels/thinning.py, which has a drawing.

const BLOCK = 1024;
const FLOATS = 8;  // of a vertex: x y z, time, feed, acceleration, jerk, mm along the line of a traverse
const NO_DASH = 1e30;  // instead of the last, for strokes that are not traverses

/** Return the indices of the points of `index` that must be kept. */
function thinned(strokes, index, tolerance) {
  const {t, place, rapid} = strokes, n = index.length, kept = new Uint32Array(n), reach = tolerance / Math.sqrt(3);
  let count = 0, anchor = 0;
  const low = [-Infinity, -Infinity, -Infinity], high = [Infinity, Infinity, Infinity];
  kept[count++] = index[0];
  for (let i = 1; i < n; i++) {
    const to = index[i], before = index[i - 1];
    let from = index[anchor], span = t[to] - t[from], fits = true, moved = 0;
    for (let k = 0; k < 3; k++) {
      const slope = (place[3 * to + k] - place[3 * from + k]) / span;
      fits = fits && low[k] <= slope && slope <= high[k];
      moved += (place[3 * before + k] - place[3 * from + k]) ** 2;
    }
    if (i - 1 > anchor && (!fits || rapid[index[i - 2]] !== rapid[before] && moved > tolerance * tolerance)) {
      kept[count++] = before;
      anchor = i - 1;
      from = before;
      span = t[to] - t[from];
      low.fill(-Infinity);
      high.fill(Infinity);
    }
    for (let k = 0; k < 3; k++) {
      const change = place[3 * to + k] - place[3 * from + k];
      low[k] = Math.max(low[k], (change - reach) / span);
      high[k] = Math.min(high[k], (change + reach) / span);
    }
  }
  if (n > 1) kept[count++] = index[n - 1];
  return kept.slice(0, count);
}

/** Return the vertices of the points of `index`. A stroke has its mean feed, and its largest acceleration and jerk. */
function vertices(strokes, index) {
  const {t, place, channels, rapid} = strokes, n = index.length, out = new Float32Array(FLOATS * n);
  for (let i = 0; i < n; i++) {
    const from = index[i], to = i + 1 < n ? index[i + 1] : from, o = FLOATS * i;
    let feed = 0, accel = 0, jerk = 0;
    for (let k = from; k < to; k++) {
      feed += channels[0][k] * (t[k + 1] - t[k]);
      if (Math.abs(channels[1][k]) > Math.abs(accel)) accel = channels[1][k];
      if (Math.abs(channels[2][k]) > Math.abs(jerk)) jerk = channels[2][k];
    }
    for (let k = 0; k < 3; k++) out[o + k] = place[3 * from + k];
    out[o + 3] = t[from];
    out[o + 4] = t[to] > t[from] ? feed / (t[to] - t[from]) : channels[0][from];
    out[o + 5] = accel;
    out[o + 6] = jerk;
    out[o + 7] = NO_DASH;
  }
  dashes(strokes, index, out);
  return out;
}

/** Set the distance of traverses along their lines. It is measured from the point nearest to machine zero, so that
 * the dashes of traverses over the same line coincide in both directions. */
function dashes({place, rapid}, index, out) {
  const n = index.length, is = i => i + 1 < n && rapid[index[i + 1] - 1] !== 0;
  const way = (i, j) => {
    const step = [0, 1, 2].map(k => place[3 * index[j] + k] - place[3 * index[i] + k]), far = Math.hypot(...step);
    return [far, ...step.map(each => far ? each / far : 0)];
  };
  for (let i = 0; i < n - 1; i++) {
    if (!is(i)) continue;
    let j = i + 1;
    for (let run = way(i, j); is(j); j++) {
      const [far, x, y, z] = way(j, j + 1);
      if (run[0] && far > 1e-3 && run[1] * x + run[2] * y + run[3] * z < 0.9998) break;
      run = way(i, j + 1);
    }
    const [, ...line] = way(i, j), most = Math.max(...line.map(Math.abs));
    if (line.find(each => Math.abs(each) > 0.5 * most) < 0) for (let k = 0; k < 3; k++) line[k] = -line[k];
    for (; i < j; i++) out[FLOATS * i + 7] = line[0] * place[3 * index[i]] + line[1] * place[3 * index[i] + 1] + line[2] * place[3 * index[i] + 2];
    i--;
  }
}

/** Return the bounding box of each BLOCK strokes: six numbers, least and greatest. */
function boxes(data) {
  const n = data.length / FLOATS, blocks = Math.max(0, Math.ceil((n - 1) / BLOCK)), out = new Float32Array(6 * blocks);
  for (let b = 0; b < blocks; b++) {
    const o = 6 * b;
    out.fill(Infinity, o, o + 3);
    out.fill(-Infinity, o + 3, o + 6);
    for (let i = b * BLOCK; i <= Math.min((b + 1) * BLOCK, n - 1); i++) {
      for (let k = 0; k < 3; k++) {
        out[o + k] = Math.min(out[o + k], data[FLOATS * i + k]);
        out[o + 3 + k] = Math.max(out[o + 3 + k], data[FLOATS * i + k]);
      }
    }
  }
  return out;
}

/** A level of detail. Its vertices are computed at the first use. `tolerance` adds to the tolerance of the page. */
class Level {
  constructor(strokes, index, tolerance) {
    Object.assign(this, {strokes, index, tolerance, n: index.length});
  }

  get data() { return this.made ??= vertices(this.strokes, this.index); }
  get boxes() { return this.spaces ??= boxes(this.data); }
}

/** Return the levels from fine to coarse. */
function levels(strokes, size, tolerance) {
  let index = new Uint32Array(strokes.n);
  for (let i = 0; i < index.length; i++) index[i] = i;
  const out = [];
  let off = 0;
  while (true) {
    out.push(new Level(strokes, index, off));
    tolerance *= 4;
    if (index.length < 2000 || tolerance > size / 50) return out;
    off += tolerance;
    index = thinned(strokes, index, tolerance);
  }
}
