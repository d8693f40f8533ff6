// A height map in the page: its heights in colours, the points that differ from their neighbours, and points to probe again.

import {attempt, get, on, post} from "./api.js";
import {needs, say, shown} from "./machine.js";
import {onPart} from "./parts.js";
import {t} from "./texts.js";

const element = id => document.getElementById(id);
const LEAST = 0.03;    // mm; a smaller difference is that of a probe
const FACTOR = 6;      // of the usual difference of a point from its neighbours
const MOST = 60;       // points that are proposed
const PAD = 22;        // px
const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]];

let map = null, name = "", bad = [], chosen = new Set();

export async function begin() {
  element("map-shown").addEventListener("change", () => attempt(open));
  element("map-again").addEventListener("click", () => attempt(again));
  element("map-picture").addEventListener("click", press);
  new ResizeObserver(draw).observe(element("map-picture"));
  onPart(part => { if (part === "probe") draw(); });
  on("height-map", () => attempt(list));
  await list();
}

async function list() {
  const names = await get("height-maps"), select = element("map-shown");
  select.replaceChildren(...names.map(each => new Option(each)));
  if (names.includes(name)) select.value = name;
  element("map-card").classList.toggle("empty", !names.length);
  await open();
}

async function open() {
  name = element("map-shown").value;
  map = name ? await get(`height-maps/${encodeURIComponent(name)}`) : null;
  bad = map === null ? [] : differing(map);
  const missed = map === null ? [] : gaps(map), values = known(map);
  chosen = new Set([...missed, ...bad.map(({at}) => at)].slice(0, MOST));
  element("map-range").textContent = map === null ? t`There is no height map yet.` : t`${map.x.length} x ${map.y.length} points, Z ${shown(Math.min(...values))} to ${shown(Math.max(...values))} of ${map.system}` + (missed.length ? t`; ${missed.length} without a contact` : "") + (bad.length ? t`; ${bad.length} differ from their neighbours` : "");
  showPoints();
}

/** Return the heights of the points at which the probe met something. */
const known = of => (of?.heights.flat() ?? []).filter(height => height !== null);

/** Return the points at which it met nothing. */
const gaps = ({heights}) => heights.flatMap((row, y) => row.flatMap((height, x) => height === null ? [`${x} ${y}`] : []));

/** Return the value on a line through two places. */
const through = (at, [a, va], [b, vb]) => va + (vb - va) * (at - a) / (b - a);

/**
 * Return the points that differ from what their neighbours let expect, the worst first.
 * Of the directions the one counts that fits best, so that a good point beside a bad one is not accused.
 */
export function differing({x, y, heights}) {
  const points = [];
  for (let row = 0; row < y.length; row++) for (let column = 0; column < x.length; column++) {
    if (heights[row][column] === null) continue;
    const of = [[column, x, k => heights[row][k]], [row, y, k => heights[k][column]]], differences = [];
    for (const [k, places, value] of of) {
      for (const [a, b] of [[k - 1, k + 1], [k - 2, k - 1], [k + 1, k + 2]]) {
        if (a >= 0 && b < places.length && value(a) !== null && value(b) !== null) differences.push(heights[row][column] - through(places[k], [places[a], value(a)], [places[b], value(b)]));
      }
    }
    // A map of two rows has no third point on a line.
    if (differences.length) points.push({at: `${column} ${row}`, by: differences.reduce((best, each) => Math.abs(each) < Math.abs(best) ? each : best)});
  }
  const sizes = points.map(({by}) => Math.abs(by)).sort((a, b) => a - b), limit = Math.max(FACTOR * (sizes[Math.floor(sizes.length / 2)] ?? 0), LEAST);
  return points.filter(({by}) => Math.abs(by) > limit).sort((a, b) => Math.abs(b.by) - Math.abs(a.by));
}

function showPoints() {
  element("map-points").replaceChildren(...[...chosen].map(at => {
    const [column, row] = at.split(" ").map(Number), item = document.createElement("li"), label = document.createElement("label"), box = Object.assign(document.createElement("input"), {type: "checkbox", checked: true});
    const by = bad.find(each => each.at === at)?.by;
    label.className = "check";
    box.addEventListener("change", () => {
      chosen.delete(at);
      showPoints();
    });
    label.append(box, ` X ${shown(map.x[column] - map.work_zero.x)}, Y ${shown(map.y[row] - map.work_zero.y)}: ${map.heights[row][column] === null ? t`no contact` : `Z ${shown(map.heights[row][column])}`}${by === undefined ? "" : t`, ${by > 0 ? "+" : ""}${shown(by)} beside its neighbours`}`);
    item.append(label);
    return item;
  }));
  element("map-again").querySelector("span").textContent = chosen.size === 1 ? t`Probe this point again` : t`Probe these ${chosen.size} points again`;
  needs();
  draw();
}

async function again() {
  if (!chosen.size) {
    say(t`no point is chosen\npress a point of the picture`);
    return;
  }
  const entries = new FormData(element("grid-form")), number = each => Number(entries.get(each));
  await post(`height-maps/${encodeURIComponent(name)}/again`, {points: [...chosen].map(at => at.split(" ").map(Number)), clear: number("clear"), depth: number("depth"), feed: number("feed")});
}

/** Return the place of a point on the canvas. */
function place(column, row) {
  const {clientWidth: w, clientHeight: h} = element("map-picture"), {x, y} = map;
  const scale = Math.min((w - 2 * PAD) / (x.at(-1) - x[0]), (h - 2 * PAD) / (y.at(-1) - y[0]));
  return [w / 2 + scale * (x[column] - (x[0] + x.at(-1)) / 2), h / 2 - scale * (y[row] - (y[0] + y.at(-1)) / 2)];
}

function press(event) {
  if (map === null) return;
  let best = Infinity, at = "";
  for (let row = 0; row < map.y.length; row++) for (let column = 0; column < map.x.length; column++) {
    const [x, y] = place(column, row), far = Math.hypot(x - event.offsetX, y - event.offsetY);
    if (far < best) [best, at] = [far, `${column} ${row}`];
  }
  if (chosen.has(at)) chosen.delete(at);
  else chosen.add(at);
  showPoints();
}

function draw() {
  const canvas = element("map-picture"), dpr = devicePixelRatio, w = canvas.clientWidth, h = canvas.clientHeight, pen = canvas.getContext("2d");
  if (!w) return;
  [canvas.width, canvas.height] = [Math.round(w * dpr), Math.round(h * dpr)];
  pen.setTransform(dpr, 0, 0, dpr, 0, 0);
  if (map === null) return;
  const shade = each => getComputedStyle(document.documentElement).getPropertyValue(`--${each}`).trim();
  const values = known(map), low = Math.min(...values), span = Math.max(Math.max(...values) - low, 1e-9);
  const [ax, ay] = place(0, 0), [bx, by] = place(1, 1), r = Math.max(Math.min(0.42 * Math.abs(bx - ax), 0.42 * Math.abs(by - ay), PAD - 6), 2);
  for (let row = 0; row < map.y.length; row++) for (let column = 0; column < map.x.length; column++) {
    const [x, y] = place(column, row), height = map.heights[row][column];
    pen.beginPath();
    if (height === null) {
      // A cross: nothing was met here.
      const arm = 0.7 * r;
      for (const side of [-arm, arm]) {
        pen.moveTo(x - arm, y - side);
        pen.lineTo(x + arm, y + side);
      }
      pen.strokeStyle = shade("error");
      pen.lineWidth = 2;
      pen.stroke();
    } else {
      const part = (height - low) / span * (RAMP.length - 1), k = Math.min(Math.floor(part), RAMP.length - 2);
      pen.fillStyle = `rgb(${RAMP[k].map((each, n) => Math.round(each + (RAMP[k + 1][n] - each) * (part - k))).join(" ")})`;
      pen.arc(x, y, r, 0, 2 * Math.PI);
      pen.fill();
    }
    if (!chosen.has(`${column} ${row}`)) continue;
    pen.strokeStyle = shade("error");
    pen.lineWidth = 3;
    pen.beginPath();
    pen.arc(x, y, r + 4, 0, 2 * Math.PI);
    pen.stroke();
  }
}
