// The toolpath with the tool, and the planned and the reported speed over time. The scene is that of `cncrun view`.

/* global Scene, load, packages, upTo, VIEWS, FLOATS, NO_DASH */
import {on} from "./api.js";
import {drawDimensions} from "./dimensions.js";
import {machine} from "./machine.js";
import {icon} from "./parts.js";
import {Part, decoded} from "./part.js";
import * as playback from "./playback.js";
import {said, t, word} from "./texts.js";

const element = id => document.getElementById(id);
const RAMP = {
  light: ["#440154", "#481a6c", "#414487", "#31688e", "#2a788e", "#1f988b", "#35b779", "#54c568"],
  dark: ["#4f63ad", "#3f7c9c", "#2f9594", "#35ab86", "#58bf70", "#86cc5e", "#b3d457", "#dbdb70"],
};
const EDGES = [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];
const MOST_CHOSEN = 40000;  // numbers of the strokes of a line that is shown
const MOST_REPORTS = 20000;
const LEFT = 46, BOTTOM = 16, TOP = 6;

let hasSizes = false;  // whether the dimensions are shown
let whole = false;  // whether the picture is that of the plan
let view = "3d";     // the view that is fitted to the canvas; null after a turn or a move by hand
let size = "";       // of the canvas for which it was fitted: a hidden one has none
let model = null, scene = null, part = null, job = null, state = null, due = false, reports = [], chosen = [];
let box = null;      // of the cuts

const shade = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();
const triple = colour => [1, 3, 5].map(k => parseInt(colour.slice(k, k + 2), 16) / 255);

export function begin() {
  for (const name of Object.keys(VIEWS)) {
    const made = Object.assign(document.createElement("button"), {type: "button", textContent: name === "3d" ? "3D" : word(name)});
    made.addEventListener("click", () => {
      fit(name);
      redraw();
    });
    element("views").append(made);
  }
  const sizes = Object.assign(document.createElement("button"), {type: "button", className: "icon-only", title: t`Dimensions of the cuts`});
  sizes.setAttribute("aria-label", sizes.title);
  sizes.setAttribute("aria-pressed", "false");
  sizes.append(icon("ruler"));
  sizes.addEventListener("click", () => {
    hasSizes = !hasSizes;
    sizes.setAttribute("aria-pressed", String(hasSizes));
    redraw();
  });
  element("views").append(sizes);
  playback.begin(redraw);
  on("state", event => {
    const before = visible();
    state = event;
    if (event.program === job && event.state === "running" && event.feed !== null) {
      reports.push([event.run_time, event.feed / 60]);
      if (reports.length > MOST_REPORTS) reports = reports.filter((_, k) => k % 2);
    }
    if (visible() !== before) redraw();
  });
  on("dialog", ({kind, approach}) => { if (kind === "restart") showApproach(approach); });
  on("job-ended", () => showApproach([]));
  pointer(element("space"));
  new ResizeObserver(redraw).observe(element("space"));
}

/** Forget the picture. */
export function clear() {
  model = scene = part = job = box = null;
  whole = false;
  reports = [];
  chosen = [];
  element("picture-note").textContent = "";
  playback.take(0, () => 0);
  redraw();
}

/** Return whether the path of the check is shown. */
export const isWhole = () => whole;

/** Return the machine positions of the sides of the cuts of the whole path, [low, high] of X, Y and Z, or null. */
export function cutBox() {
  if (model === null || !whole) return null;
  const {n, place, rapid, origin} = model.strokes, box = [0, 1, 2].map(() => [Infinity, -Infinity]);
  for (let i = 1; i < n; i++) if (!rapid[i - 1]) for (const k of [0, 1, 2]) for (const at of [i - 1, i]) {
    const value = place[3 * at + k] + origin[k];
    box[k] = [Math.min(box[k][0], value), Math.max(box[k][1], value)];
  }
  return box[0][0] > box[0][1] ? null : box;
}

/** Return the place of the tool between two points of the path, k and the next, at a time. */
function between(k, time) {
  const {t, place} = model.strokes, part = Math.min(Math.max((time - t[k]) / Math.max(t[k + 1] - t[k], 1e-12), 0), 1);
  return [0, 1, 2].map(axis => place[3 * k + axis] + part * (place[3 * k + 3 + axis] - place[3 * k + axis]));
}

/** Return the place of the tool at a time of the plan. */
const placeAt = time => between(Math.min(Math.max(upTo(model.strokes.t, time) - 1, 0), model.strokes.n - 2), time);

/** Return the line of the program at a time of the plan, 0 for none. */
function lineAt(time) {
  const {t, first, file} = model.origins, i = upTo(t, time) - 1;
  return i >= 0 && file[i] === 0 ? first[i] : 0;
}

/** Show the path of a source line over the others; 0 for none. */
export function showLine(number) {
  chosen = [];
  if (model !== null && number) {
    const {t: begins, first, more, file} = model.origins, {n, t} = model.strokes;
    for (let i = 0; i < begins.length; i++) if (file[i] === 0 && first[i] <= number && number <= first[i] + more[i]) {
      const end = begins[i + 1] ?? Infinity;
      for (let k = Math.max(upTo(t, begins[i]) - 1, 0); k + 1 < n && t[k] < end && chosen.length < MOST_CHOSEN; k++) {
        chosen.push(...between(k, begins[i]), 0, 0, 0, 0, NO_DASH, ...between(k, end), 0, 0, 0, 0, NO_DASH);
      }
    }
  }
  element("space").dataset.chosen = chosen.length / 2 / FLOATS;
  redraw();
}

/** Return whether a time of the path is shown in place of the machine. */
export const isPlayed = () => playback.shownTime() !== null;

/** A run begins: the reported speeds of the last one go. */
export function restart() {
  reports = [];
}

/** Show the toolpath of a job. */
export async function show(found, name, {isWhole = true, seconds = null} = {}) {
  const stored = new Map(Object.entries(found.columns).map(([key, text]) => [`column-${key}`, text]));
  packages = {has: id => stored.has(id), take: id => stored.get(id)};  // eslint-disable-line no-global-assign
  const loaded = await load(found.about), {about, strokes} = loaded, {origin} = strokes;
  model = loaded;
  whole = isWhole;
  job = name;
  model.size = Math.max(Math.hypot(...about.extent.map(([low, high]) => high - low)), 1e-3);
  const boxes = [about.extent, about.travel, about.stock].filter(Boolean);
  model.reach = Math.max(model.size, ...boxes.map(box => Math.hypot(...box.map(([low, high], k) => Math.max(Math.abs(low - origin[k]), Math.abs(high - origin[k]))))));
  scene = new Scene(element("space"), model, [...edges(about.travel, origin, "travel"), ...edges(about.stock, origin, "stock")]);
  if (!scene.gl) element("picture-note").textContent = t`The path needs WebGL 2, which this browser does not have.`;
  else element("picture-note").textContent = said(about.facts) + (isOther(seconds, about.duration)
    ? t`. This is the plan of cncrun; the board plans by itself and takes ${seconds.toFixed(1)} s.` : "");
  playback.take(isWhole && about.duration > 0 && strokes.n > 1 ? about.duration : 0, lineAt);
  box = cutBox();
  fit(view ?? "3d");
  redraw();
}

/** Fit a view to the canvas at the next drawing, and again when its size changes. */
function fit(name) {
  view = name;
  size = "";
}

/** Return whether the time of the board differs from that of the plan in the picture. */
const isOther = (seconds, planned) => seconds !== null && planned > 0 && Math.abs(seconds - planned) > Math.max(0.01 * planned, 0.05);

/** Show the part that a simulated cut leaves. */
export async function showPart(found, name) {
  if (name !== job || !scene?.gl) return;
  const surface = await decoded(found, model.strokes.origin);
  scene.shown = [...edges(model.about.travel, model.strokes.origin, "travel"), ...edges(found.box, model.strokes.origin, "stock")];
  scene.prepare();
  part = new Part(scene.gl, surface);
  fit(view ?? "3d");
  redraw();
}

/** Show the moves that lead to the line at which a run begins; places in the order of the axes. */
function showApproach(places) {
  if (!scene?.gl) return;
  const {origin} = model.strokes, letters = Object.keys(machine.axes), at = place => ["x", "y", "z"].map((letter, k) => (place[letters.indexOf(letter)] ?? 0) - origin[k]);
  const data = places.slice(1).flatMap((place, k) => [...at(places[k]), 0, 0, 0, 0, NO_DASH, ...at(place), 0, 0, 0, 0, NO_DASH]);
  scene.shown = scene.shown.filter(({isApproach}) => !isApproach);
  if (data.length) scene.shown.push({data: new Float32Array(data), isApproach: true, whole: true, colour: () => triple(shade("reported"))});
  element("space").dataset.approach = Math.max(places.length - 1, 0);
  scene.prepare();
  redraw();
}

function edges(box, origin, name) {
  if (!box) return [];
  const corner = k => [0, 1, 2].map(axis => box[axis][k >> axis & 1] - origin[axis]);
  const data = EDGES.flatMap(([a, b]) => [...corner(a), 0, 0, 0, 0, NO_DASH, ...corner(b), 0, 0, 0, 0, NO_DASH]);
  return [{data: new Float32Array(data), whole: name === "stock", colour: () => triple(shade(name))}];
}

export function redraw() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    draw();
    chart();
  });
}

const runs = () => state !== null && state.program === job && job !== null && ["running", "held", "door"].includes(state.state);

/** Return what the picture shows of the state: a machine at rest costs a telephone no drawing. */
const visible = () => JSON.stringify([state?.machine, runs() && state.run_time]);

function draw() {
  const {clientWidth, clientHeight} = element("space"), now = `${clientWidth} ${clientHeight}`;
  if (!scene?.gl || !clientWidth) return;
  if (view !== null && size !== now) scene.look(view);
  size = now;
  const {origin} = model.strokes, dark = document.documentElement.dataset.theme === "dark";
  const at = state?.machine ?? {}, played = playback.shownTime();
  const place = played === null ? ["x", "y", "z"].map((letter, k) => (at[letter] ?? NaN) - origin[k]) : placeAt(played);
  element("space").dataset.tool = place.map((each, k) => (each + origin[k]).toFixed(3)).join(" ");
  const over = place.some(Number.isNaN) ? chosen : [...tool(place), ...chosen];
  scene.choose(over.length ? new Float32Array(over) : null);
  scene.draw({
    channel: 0, range: [0, Math.max(model.about.limits[0] || 1, 1e-6)], ramp: RAMP[dark ? "dark" : "light"].map(triple),
    paper: triple(shade("paper")), rapid: triple(shade("rapid")), accent: triple(shade("reported")),
    now: played ?? (runs() ? state.run_time : Infinity),
  });
  if (!runs() && played === null) part?.draw(scene, triple(shade("stock")));
  const project = (x, y, z) => scene.project(x - origin[0], y - origin[1], z - origin[2]);
  // Along the axes of the machine a turned system has no places.
  const zero = state?.rotation ? {} : state?.zero ?? {};
  const texts = drawDimensions(element("over"), hasSizes ? box : null, project, zero, {ink: shade("ink"), paper: shade("paper")});
  element("over").dataset.texts = texts.join("; ");
}

/** Return the numbers of the strokes of a tool whose tip is at a place: a tip and a shank. */
function tool([x, y, z]) {
  const size = Math.max(30 / scene.scale, 1e-3), r = size / 4, out = [];
  const line = (a, b) => out.push(...a, 0, 0, 0, 0, NO_DASH, ...b, 0, 0, 0, 0, NO_DASH);
  for (const [dx, dy] of [[r, 0], [-r, 0], [0, r], [0, -r]]) {
    line([x, y, z], [x + dx, y + dy, z + size / 2]);
    line([x + dx, y + dy, z + size / 2], [x + dx, y + dy, z + 2 * size]);
  }
  return out;
}

/** Planned and reported speed over time: each column of pixels shows the least and the greatest speed in it, of both alike. */
function chart() {
  const canvas = element("chart"), dpr = devicePixelRatio, w = canvas.clientWidth, h = canvas.clientHeight, pen = canvas.getContext("2d");
  if (!w) return;
  if (canvas.width !== Math.round(w * dpr) || canvas.height !== Math.round(h * dpr)) [canvas.width, canvas.height] = [Math.round(w * dpr), Math.round(h * dpr)];
  pen.setTransform(dpr, 0, 0, dpr, 0, 0);
  pen.clearRect(0, 0, w, h);
  pen.font = "11px system-ui, 'DejaVu Sans', sans-serif";
  pen.fillStyle = shade("faint");
  if (model === null) return;
  const {curves, about} = model, end = about.duration || 1, width = w - LEFT - 6, height = h - TOP - BOTTOM;
  const values = curves.exact ? curves.start[0] : curves.high[0], least = curves.exact ? values : curves.low[0], n = values.length;
  let most = 1e-6;
  for (let i = 0; i < n; i++) most = Math.max(most, values[i]);
  for (const [, value] of reports) most = Math.max(most, value);
  const x = t => LEFT + Math.min(t / end, 1) * width, y = v => TOP + height * (1 - v / most);
  pen.textAlign = "right";
  pen.fillText(most.toPrecision(3), LEFT - 4, TOP + 9);
  pen.fillText("0", LEFT - 4, TOP + height);
  pen.fillText(`${end.toPrecision(4)} s`, w - 6, h - 3);
  const plan = [], told = [], column = t => Math.min(Math.floor((t / end) * width), Math.ceil(width) - 1);
  let i = 0;
  for (let pixel = 0; pixel < width; pixel++) {
    const until = end * (pixel + 1) / width, last = Math.min(upTo(curves.t, until), n);
    const ends = [planned(end * pixel / width), planned(until)], band = [Math.min(...ends), Math.max(...ends)];
    for (; i < last; i++) if (curves.t[i] > until - end / width) widen(band, least[i], values[i]);
    plan.push([pixel, ...band]);
  }
  for (const [t, value] of reports) {
    const at = column(t), band = told.at(-1)?.[0] === at ? told.at(-1) : null;
    if (band === null) told.push([at, value, value]);
    else [band[1], band[2]] = [Math.min(band[1], value), Math.max(band[2], value)];
  }
  for (const [bands, name] of [[plan, "planned"], [told, "reported"]]) {
    pen.strokeStyle = pen.fillStyle = shade(name);
    pen.lineWidth = 1.3;
    pen.beginPath();
    for (const [pixel, , high] of bands) pen.lineTo(LEFT + pixel, y(high));
    for (const [pixel, low] of bands.toReversed()) pen.lineTo(LEFT + pixel, y(low));
    pen.closePath();
    pen.stroke();
    pen.globalAlpha = 0.25;
    pen.fill();
    pen.globalAlpha = 1;
  }
  const time = playback.shownTime() ?? (runs() ? state.run_time : null);
  if (time !== null) {
    pen.strokeStyle = shade("ink");
    pen.beginPath();
    pen.moveTo(x(time), TOP);
    pen.lineTo(x(time), TOP + height);
    pen.stroke();
  }
}

/** Widen a band by the least and the greatest value of a row. */
function widen(band, low, high) {
  band[0] = Math.min(band[0], low);
  band[1] = Math.max(band[1], high);
}

/** Return the planned speed at a time, mm/s. */
function planned(t) {
  const {curves} = model, n = curves.t.length - 1, i = Math.min(Math.max(upTo(curves.t, t) - 1, 0), n - 1);
  if (n < 1) return 0;
  if (!curves.exact) return curves.high[0][i];
  const [v, a, j] = curves.start.map(each => each[i]), h = Math.min(t, curves.t[i + 1]) - curves.t[i];
  return Math.max(v + h * (a + 0.5 * h * j), 0);
}

/** Turn, move and magnify the view by mouse, touch and keys. */
function pointer(canvas) {
  const down = new Map();
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, [event.clientX, event.clientY]);
  });
  canvas.addEventListener("pointermove", event => {
    const before = down.get(event.pointerId);
    if (!before || !scene) return;
    const here = [event.clientX, event.clientY], [dx, dy] = [here[0] - before[0], here[1] - before[1]];
    if (down.size === 2) {
      const other = [...down].find(([id]) => id !== event.pointerId)[1], box = canvas.getBoundingClientRect();
      const far = at => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
      scene.zoom(far(here) / far(before), (here[0] + other[0]) / 2 - box.left, (here[1] + other[1]) / 2 - box.top);
      scene.move(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons & 6) scene.move(dx, dy);
    else scene.rotate(dx, dy);
    down.set(event.pointerId, here);
    view = null;
    scene.moving(redraw);
  });
  for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, event => down.delete(event.pointerId));
  canvas.addEventListener("wheel", event => {
    event.preventDefault();
    scene?.zoom(Math.exp(-event.deltaY * 0.0015), event.offsetX, event.offsetY);
    view = null;
    scene?.moving(redraw);
  }, {passive: false});
  canvas.addEventListener("keydown", event => {
    const turn = {ArrowLeft: [-20, 0], ArrowRight: [20, 0], ArrowUp: [0, -20], ArrowDown: [0, 20]}[event.key];
    if (turn) scene?.rotate(...turn);
    else if (event.key === "+" || event.key === "-") scene?.zoom(event.key === "+" ? 1.25 : 0.8, canvas.clientWidth / 2, canvas.clientHeight / 2);
    else return;
    view = null;
    event.preventDefault();
    redraw();
  });
}
