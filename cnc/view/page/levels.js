// The path in several levels of detail. Each level leaves out points of the one before that its other points show
// within its tolerance, by the method of cnc/view/kernels/thinning.py, which has a drawing.

const BLOCK = 1024;
const FLOATS = 8;  // of a vertex: x y z, time, feed, acceleration, jerk, mm along the line of a traverse
const NO_DASH = 1e30;  // instead of the last, for strokes that are not traverses
const NO_DASH_32 = Math.fround(NO_DASH);
const MOST_CELLS = 2e6;  // of a grid that a search for covering strokes passes through

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

/** Return the bounding box of each BLOCK strokes: six numbers, least and greatest. A stroke begins every `stride` points. */
function boxes(data, stride) {
  const n = data.length / FLOATS, blocks = Math.max(0, Math.ceil((n - 1) / stride / BLOCK)), out = new Float32Array(6 * blocks);
  for (let b = 0; b < blocks; b++) {
    const o = 6 * b;
    out.fill(Infinity, o, o + 3);
    out.fill(-Infinity, o + 3, o + 6);
    for (let i = stride * b * BLOCK; i <= Math.min(stride * (b + 1) * BLOCK + 1 - stride, n - 1); i++) {
      for (let k = 0; k < 3; k++) {
        out[o + k] = Math.min(out[o + k], data[FLOATS * i + k]);
        out[o + 3 + k] = Math.max(out[o + 3 + k], data[FLOATS * i + k]);
      }
    }
  }
  return out;
}

/** Return pairs of points of strokes that cover all strokes of a level: each stroke that is left out passes mostly through
 * cells of a grid that those which are kept pass through. Traverses are kept. Null where that would take too long. */
function covering({data, n}, cell) {
  const cells = o => Math.ceil(Math.max(Math.abs(data[o + 8] - data[o]), Math.abs(data[o + 9] - data[o + 1]), Math.abs(data[o + 10] - data[o + 2])) / cell) + 1;
  let sum = 0, most = 0;
  for (let i = 0; i + 1 < n; i++) {
    const count = cells(FLOATS * i);
    sum += count;
    most = Math.max(most, count);
  }
  if (!(sum < MOST_CELLS)) return null;
  const taken = new Uint8Array(1 << 20), fresh = new Int32Array(most), kept = [];  // a bit for each cell; cells may share one
  const mixed = key => { key = Math.imul(key, 0x9e3779b1); return key ^ key >>> 15; };
  for (let i = 0; i + 1 < n; i++) {
    const o = FLOATS * i, count = cells(o), step = 1 / Math.max(count - 1, 1) / cell;
    const x = data[o] / cell, y = data[o + 1] / cell, z = data[o + 2] / cell;
    const dx = (data[o + 8] - data[o]) * step, dy = (data[o + 9] - data[o + 1]) * step, dz = (data[o + 10] - data[o + 2]) * step;
    let free = 0;
    for (let c = 0; c < count; c++) {
      const key = mixed(mixed(mixed(Math.floor(x + c * dx)) ^ Math.floor(y + c * dy)) ^ Math.floor(z + c * dz)) & 0x7fffff;
      if (!(taken[key >> 3] & 1 << (key & 7))) fresh[free++] = key;
    }
    if (4 * free <= count && data[o + 7] === NO_DASH_32) continue;
    for (let k = 0; k < free; k++) taken[fresh[k] >> 3] |= 1 << (fresh[k] & 7);
    kept.push(i);
  }
  const out = new Float32Array(2 * FLOATS * kept.length);
  kept.forEach((i, k) => out.set(data.subarray(FLOATS * i, FLOATS * (i + 2)), 2 * FLOATS * k));
  return out;
}

/** Strokes to draw: from each point to the next (`stride` 1), or of pairs (2). */
class Strokes {
  constructor(data, stride) {
    Object.assign(this, {data, stride, count: Math.floor((data.length / FLOATS + stride - 2) / stride)});
  }

  get boxes() { return this.spaces ??= boxes(this.data, this.stride); }
}

/** A level of detail. Its vertices are computed at the first use. `tolerance` adds to the tolerance of the page. */
class Level {
  constructor(strokes, index, tolerance) {
    Object.assign(this, {strokes, index, tolerance, n: index.length});
  }

  get data() { return this.all.data; }

  get all() { return this.made ??= new Strokes(vertices(this.strokes, this.index), 1); }

  /** Strokes that look like all of them where the tolerance is hardly seen; all where these are not many more. */
  get few() {
    if (!this.cover) {
      const data = this.tolerance > 0 ? covering(this, 0.6 * this.tolerance) : null;
      this.cover = data && data.length < FLOATS * this.n ? new Strokes(data, 2) : this.all;
    }
    return this.cover;
  }
}

/** Return the levels from fine to coarse. */
function levels(strokes, size, tolerance) {
  let index = new Uint32Array(strokes.n);
  for (let i = 0; i < index.length; i++) index[i] = i;
  const out = [];
  let off = 0;
  while (true) {
    out.push(new Level(strokes, index, off));
    tolerance *= 2;
    if (index.length < 2000 || tolerance > size / 50) return out;
    off += tolerance;
    index = thinned(strokes, index, tolerance);
  }
}
