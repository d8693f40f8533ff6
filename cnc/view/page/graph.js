// Feed, acceleration and jerk of the tip over time, or position, velocity and acceleration of a joint. Each column of pixels shows its least and greatest value, so that no peak is
// lost. Phases wider than a pixel are drawn exactly: feed as parabolas, acceleration as lines, jerk as steps.

const TIP = [["feed", "mm/s"], ["acceleration", "mm/s\u00b2"], ["jerk", "mm/s\u00b3"]];
const JOINT = unit => [["position", unit], ["velocity", unit + "/s"], ["acceleration", unit + "/s\u00b2"]];
const FAR = 2.5;  // ratio to the greatest value; a higher limit is not shown
const LEFT = 88, RIGHT = 10, TOP = 8, BOTTOM = 22, GAP = 10;

class Graph {
  constructor(canvas, model) {
    this.canvas = canvas;
    this.model = model;
    this.end = model.about.duration || 1;
    this.range = [0, this.end];
    this.choose(0);
  }

  /** Show the curves of the tip (0), or of a joint, from 1 on. */
  choose(number) {
    const {model} = this, joint = model.joints[number - 1];
    this.joint = joint ?? null;
    this.curves = joint ?? model.curves;
    this.strips = joint ? JOINT(joint.unit) : TIP;
    this.n = this.curves.t.length - 1;
    this.ranges = [0, 1, 2].map(k => this.pyramid(k));
    const limits = joint ? [0, ...joint.limits] : model.about.limits;
    const ends = this.ranges.map(({low, high}) => low.at(-1).length ? [low.at(-1)[0], high.at(-1)[0]] : [0, 0]);
    const most = ends.map(([low, high]) => Math.max(-low, high) || 1);
    // A limit far above the values would flatten the curves.
    this.limits = limits.map((limit, k) => limit && limit <= FAR * most[k] ? limit : 0);
    this.tops = most.map((value, k) => Math.max(value, this.limits[k]));
    /** Values at the lower and the upper edge of each strip. */
    this.edges = this.tops.map((top, k) => k ? [-1.06 * top, 1.06 * top] : [0, 1.06 * top]);
    if (joint) {
      const [low, high] = ends[0], spare = 0.03 * (high - low) || 1;
      this.edges[0] = [low - spare, high + spare];
      this.tops[0] = high;
    }
  }

  /** Return feed and acceleration at both ends of row `i`, and its jerk. For exact curves only. */
  at(i) {
    const {t, start: [v, a, j]} = this.curves, span = t[i + 1] - t[i];
    const last = i + 1 >= this.n, slope = a[i] + j[i] * span, end = v[i] + span * (a[i] + 0.5 * span * j[i]);
    return [v[i], last ? end : v[i + 1], a[i], slope, j[i]];
  }

  /** Return the least and greatest values of single rows, of pairs, of four rows, and so on. */
  pyramid(k) {
    let low = new Float32Array(this.n), high = new Float32Array(this.n);
    if (!this.curves.exact) [low, high] = [this.curves.low[k], this.curves.high[k]];
    else {
      for (let i = 0; i < this.n; i++) {
        const [v, vEnd, a, aEnd, j] = this.at(i), pair = k === 0 ? [v, vEnd] : k === 1 ? [a, aEnd] : [j, j];
        if (k === 0 && a * aEnd < 0) pair.push(v - 0.5 * a * a / j);
        low[i] = Math.min(...pair);
        high[i] = Math.max(...pair);
      }
    }
    const lows = [low], highs = [high];
    while (low.length > 1) {
      const n = low.length + 1 >> 1, lower = new Float32Array(n), higher = new Float32Array(n);
      for (let i = 0; i < n; i++) {
        const other = Math.min(2 * i + 1, low.length - 1);
        lower[i] = Math.min(low[2 * i], low[other]);
        higher[i] = Math.max(high[2 * i], high[other]);
      }
      lows.push(low = lower);
      highs.push(high = higher);
    }
    return {low: lows, high: highs};
  }

  /** Return the least and greatest value of rows [first, last]. */
  within(k, first, last) {
    const {low, high} = this.ranges[k];
    let least = Infinity, most = -Infinity;
    const take = (level, i) => {
      least = Math.min(least, low[level][i]);
      most = Math.max(most, high[level][i]);
    };
    for (let level = 0; first <= last; level++, first >>= 1, last >>= 1) {
      if (first & 1) take(level, first++);
      if (!(last & 1)) take(level, last--);
      if (first > last) break;
    }
    return [least, most];
  }

  get width() { return Math.max(this.canvas.clientWidth - LEFT - RIGHT, 1); }
  x(t) { return LEFT + (t - this.range[0]) / (this.range[1] - this.range[0]) * this.width; }
  time(x) { return this.range[0] + Math.min(Math.max((x - LEFT) / this.width, 0), 1) * (this.range[1] - this.range[0]); }

  show(a, b) {
    const span = Math.min(Math.max(b - a, 1e-6), this.end), from = Math.min(Math.max(a, 0), this.end - span);
    this.range = [from, from + span];
  }

  zoom(factor, x) {
    const t = this.time(x), [a, b] = this.range;
    this.show(t - (t - a) / factor, t + (b - t) / factor);
  }

  /** Return the values of the strips at a time, each as [least, greatest]. */
  values(t) {
    const i = Math.min(Math.max(upTo(this.curves.t, t) - 1, 0), this.n - 1);
    if (this.n < 1) return [[0, 0], [0, 0], [0, 0]];
    if (!this.curves.exact) return [0, 1, 2].map(k => [this.ranges[k].low[0][i], this.ranges[k].high[0][i]]);
    const [v, vEnd, a, aEnd, j] = this.at(i), span = this.curves.t[i + 1] - this.curves.t[i];
    const part = span > 0 ? Math.min(Math.max((t - this.curves.t[i]) / span, 0), 1) : 0, h = part * span;
    const feed = v + h * a + (vEnd - v - span * a) * part * part;
    return [feed, a + (aEnd - a) * part, j].map(value => [value, value]);
  }

  draw(colours, marks) {
    const {canvas} = this, dpr = devicePixelRatio, w = canvas.clientWidth, h = canvas.clientHeight, pen = canvas.getContext("2d");
    if (canvas.width !== Math.round(w * dpr) || canvas.height !== Math.round(h * dpr)) {
      [canvas.width, canvas.height] = [Math.round(w * dpr), Math.round(h * dpr)];
    }
    pen.setTransform(dpr, 0, 0, dpr, 0, 0);
    pen.clearRect(0, 0, w, h);
    pen.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    const strip = (h - TOP - BOTTOM - 2 * GAP) / 3;
    this.ruler(pen, colours, h);
    for (let k = 0; k < 3; k++) {
      const top = TOP + k * (strip + GAP), [least, most] = this.edges[k];
      const y = value => top + strip * (most - value) / (most - least), zero = Math.min(Math.max(0, least), most);
      pen.strokeStyle = colours.rule;
      pen.lineWidth = 1;
      pen.setLineDash([]);
      pen.beginPath();
      pen.moveTo(LEFT, Math.round(y(zero)) + 0.5);
      pen.lineTo(LEFT + this.width, Math.round(y(zero)) + 0.5);
      pen.stroke();
      if (this.limits[k]) {
        pen.strokeStyle = colours.limit;
        pen.setLineDash([2, 3]);
        pen.beginPath();
        for (const value of k ? [this.limits[k], -this.limits[k]] : [this.limits[k]]) {
          pen.moveTo(LEFT, Math.round(y(value)) + 0.5);
          pen.lineTo(LEFT + this.width, Math.round(y(value)) + 0.5);
        }
        pen.stroke();
        pen.setLineDash([]);
      }
      pen.textAlign = "right";
      pen.fillStyle = colours.faint;
      pen.fillText(digits(this.tops[k], 3), LEFT - 6, top + 9);
      pen.fillText(this.strips[k][1], LEFT - 6, top + strip - 1);
      pen.fillStyle = colours.curves[k];
      pen.fillText(this.strips[k][0], LEFT - 6, top + strip / 2 + 4);
      pen.save();
      pen.beginPath();
      pen.rect(LEFT, top - 2, this.width, strip + 4);
      pen.clip();
      this.curve(pen, k, y, colours.curves[k]);
      pen.restore();
    }
    for (const [t, colour] of marks) {
      if (t === null || t < this.range[0] || t > this.range[1]) continue;
      pen.strokeStyle = colour;
      pen.beginPath();
      pen.moveTo(this.x(t), TOP);
      pen.lineTo(this.x(t), h - BOTTOM);
      pen.stroke();
    }
  }

  curve(pen, k, y, colour) {
    const {t} = this.curves, [a, b] = this.range;
    if (this.n < 1) return;
    const first = Math.min(Math.max(upTo(t, a) - 1, 0), this.n - 1), last = Math.min(Math.max(upTo(t, b) - 1, first), this.n - 1);
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = 1.4;
    if (this.curves.exact && last - first < this.width) {
      pen.beginPath();
      for (let i = first; i <= last; i++) {
        const [v, vEnd, accel, accelEnd, jerk] = this.at(i), [x0, x1] = [this.x(t[i]), this.x(t[i + 1])];
        if (k === 0) {
          if (i === first) pen.moveTo(x0, y(v));
          pen.quadraticCurveTo((x0 + x1) / 2, y(v + accel * (t[i + 1] - t[i]) / 2), x1, y(vEnd));
        } else {
          const [from, to] = k === 1 ? [accel, accelEnd] : [jerk, jerk];
          if (i === first) pen.moveTo(x0, y(from));
          else pen.lineTo(x0, y(from));
          pen.lineTo(x1, y(to));
        }
      }
      pen.stroke();
      return;
    }
    const from = Math.max(Math.floor(this.x(t[0])), LEFT), to = LEFT + this.width;
    let i = first;
    for (let x = from; x < to; x++) {
      const until = this.time(x + 1);
      let j = i;
      if (t[j + 1] < until) j = Math.min(Math.max(upTo(t, until) - 1, i), this.n - 1);
      const [low, high] = this.within(k, i, j), [under, over] = [y(low), y(high)];
      pen.fillRect(x, over - 0.7, 1, under - over + 1.4);
      i = j;
    }
  }

  ruler(pen, colours, h) {
    const [a, b] = this.range, rough = (b - a) / Math.max(this.width / 110, 1), ten = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].map(each => each * ten).find(each => each >= rough), places = Math.max(0, -Math.floor(Math.log10(step) + 1e-9));
    pen.textAlign = "center";
    for (let k = Math.ceil(a / step); k * step <= b + 1e-9 * step; k++) {
      const x = Math.round(this.x(k * step)) + 0.5;
      pen.strokeStyle = colours.rule;
      pen.beginPath();
      pen.moveTo(x, TOP);
      pen.lineTo(x, h - BOTTOM + 4);
      pen.stroke();
      pen.fillStyle = colours.faint;
      if (x < LEFT + this.width - 14) pen.fillText((k * step).toFixed(Math.min(places, 7)), x, h - 6);
    }
    pen.textAlign = "right";
    pen.fillText("s", LEFT + this.width, h - 6);
  }
}
