// Connects the parts of the page: a point or line selected in one of them is shown in the others.

const RAMPS = {
  light: {
    rising: ["#440154", "#481a6c", "#414487", "#31688e", "#2a788e", "#1f988b", "#35b779", "#54c568"],
    signed: ["#1f4e9c", "#3f6fb5", "#7f9cc4", "#a3a9af", "#a3a9af", "#cf9a86", "#c4623f", "#a33213"],
  },
  dark: {
    rising: ["#4f63ad", "#3f7c9c", "#2f9594", "#35ab86", "#58bf70", "#86cc5e", "#b3d457", "#dbdb70"],
    signed: ["#78b0ff", "#5f93dd", "#6a84aa", "#6c737a", "#6c737a", "#b08672", "#e5775c", "#ff8a6b"],
  },
};
const NAMES = ["feed, mm/s", "acceleration, mm/s\u00b2", "jerk, mm/s\u00b3", "time, s"];
const NEAR = 9;   // largest distance in pixels of the pointer from the path
const EDGES = [[0, 1], [2, 3], [4, 5], [6, 7], [0, 2], [1, 3], [4, 6], [5, 7], [0, 4], [1, 5], [2, 6], [3, 7]];

const element = id => document.getElementById(id);
const triple = colour => [1, 3, 5].map(k => parseInt(colour.slice(k, k + 2), 16) / 255);

/** Return the edges of a box as strokes. `whole`: the view must contain it. */
function edges(box, origin, name) {
  if (!box) return [];
  const corner = k => [0, 1, 2].map(axis => box[axis][k >> axis & 1] - origin[axis]);
  const data = EDGES.flatMap(([a, b]) => [...corner(a), 0, 0, 0, 0, NO_DASH, ...corner(b), 0, 0, 0, 0, NO_DASH]);
  return [{data: new Float32Array(data), whole: name === "stock", colour: () => triple(shade(name))}];
}

const shade = name => getComputedStyle(document.documentElement).getPropertyValue("--" + name).trim();

async function main() {
  const model = await load(), {about, strokes, origins} = model;
  const end = about.duration, darkness = matchMedia("(prefers-color-scheme: dark)");
  const extent = about.extent, {origin} = strokes;
  model.size = Math.max(Math.hypot(...extent.map(([low, high]) => high - low)), 1e-3);
  const reaches = [extent, about.travel, about.stock].filter(Boolean).map(box => Math.hypot(...box.map(([low, high], k) =>
    Math.max(Math.abs(low - origin[k]), Math.abs(high - origin[k])))));
  model.reach = Math.max(...reaches, model.size);
  element("program").textContent = document.title = about.program;
  element("facts").textContent = about.facts;
  element("accuracy").textContent = about.accuracy;

  const scene = new Scene(element("space"), model, [...edges(about.travel, origin, "travel"), ...edges(about.stock, origin, "stock")]);
  scene.lathe = about.lathe;
  const graph = new Graph(element("graph"), model);
  for (const [k, {name}] of model.joints.entries()) element("joint").append(new Option("joint " + name, k + 1));
  element("joint").hidden = model.joints.length === 0;
  const state = {channel: 0, at: null, hover: null, chosen: null, playing: false, trail: false, dark: darkness.matches};
  const source = new Source(element("source-list"), model, chooseLine);
  for (const [k, name] of about.files.entries()) element("files").append(new Option(name, k));
  element("source-head").hidden = about.files.length < 2 && !about.note;
  element("files").hidden = about.files.length < 2;
  element("source-note").textContent = about.note;
  if (!scene.gl) {
    element("trouble").hidden = false;
    element("trouble").textContent = "The path needs WebGL 2, which this browser does not have. The curves and the program are shown.";
  }
  element("space").addEventListener("webglcontextlost", event => event.preventDefault());
  element("space").addEventListener("webglcontextrestored", () => { scene.prepare(); draw(); });

  let due = false, shown = {};
  function redraw() {
    if (due) return;
    due = true;
    requestAnimationFrame(() => { due = false; draw(false); });
  }

  /** Largest magnitude of each channel on strokes that are not traverses. */
  const mosts = strokes.channels.map((values, k) => {
    let most = 0, any = 0;
    for (let i = 0; i + 1 < strokes.n; i++) {
      any = Math.max(any, Math.abs(values[i]));
      if (!strokes.rapid[i]) most = Math.max(most, Math.abs(values[i]));
    }
    return most || any || 1;
  });
  const range = () => [[0, mosts[0]], [-mosts[1], mosts[1]], [-mosts[2], mosts[2]], [0, end || 1]][state.channel];
  const ramp = () => RAMPS[state.dark ? "dark" : "light"][state.channel === 1 || state.channel === 2 ? "signed" : "rising"];

  /** Return the position of the tool at a time. */
  function place(t) {
    const i = Math.min(Math.max(upTo(strokes.t, t) - 1, 0), strokes.n - 1), next = Math.min(i + 1, strokes.n - 1);
    const span = strokes.t[next] - strokes.t[i], part = span > 0 ? Math.min(Math.max((t - strokes.t[i]) / span, 0), 1) : 0;
    return [0, 1, 2].map(k => strokes.place[3 * i + k] + part * (strokes.place[3 * next + k] - strokes.place[3 * i + k]));
  }

  /** Return the active file and lines at a time; null before the first. */
  function work(t) {
    const i = upTo(origins.t, t) - 1;
    return i < 0 ? null : {file: origins.file[i], first: origins.first[i], last: origins.first[i] + origins.more[i]};
  }

  function describe(t) {
    const at = work(t), lines = !at ? "before the first move" : at.last > at.first ? `lines ${at.first} to ${at.last}` : `line ${at.first}`;
    const name = at && at.file ? about.files[at.file] + " " : "", values = graph.values(t);
    const shown = (k, unit) => {
      const [low, high] = values[k].map(value => digits(value, 3));
      return (low === high ? low : `${low} to ${high}`) + " " + unit;
    };
    const joint = graph.joint ? graph.joint.name + ": " : "";
    // On a lathe X is a diameter.
    const axes = place(t).map((value, k) => {
      const twice = about.lathe && k === 0;
      return "XYZ"[k] + (twice ? "\u2300" : "") + digits(Math.round((value + origin[k]) * (twice ? 2 : 1) * 1000) / 1000, 7);
    }).filter((_, k) => !about.lathe || k !== 1 || extent[1][0] !== extent[1][1]).join(" ");
    return {head: `${name}${lines} \u00b7 ${clock(t)}`, rest: `${axes}\n${joint}${graph.strips.map(([, unit], k) => shown(k, unit)).join(" \u00b7 ")}`};
  }

  /** Draw what has changed, or all of it. */
  function draw(anew = true) {
    const colours = {
      rule: shade("rule"), faint: shade("faint"), limit: shade("limit"), curves: [shade("feed"), shade("accel"), shade("jerk")],
    };
    const look = {
      channel: state.channel, range: range(), ramp: ramp().map(triple), paper: triple(shade("paper")), rapid: triple(shade("rapid")),
      accent: triple(shade("accent")), now: state.trail && state.at !== null ? state.at : Infinity,
    };
    const {yaw, pitch, target, scale, coarse, chosen, canvas} = scene;
    const key = [...Object.values(look), yaw, pitch, target, scale, coarse, canvas.clientWidth, canvas.clientHeight, devicePixelRatio].join();
    if (anew || key !== shown.key || chosen !== shown.chosen) scene.draw(look);
    shown = {key, chosen};
    graph.draw(colours, [[state.at, shade("accent")], [state.hover, colours.faint]]);
    over(colours);
    legend();
    element("now").textContent = state.at === null ? `${clock(end)} in total` : describe(state.at).head;
    if (state.at !== null) element("slider").value = end ? state.at / end * 10000 : 0;
    const at = state.at === null ? null : work(state.at), marked = at && at.file === source.file ? [at.first, at.last] : null;
    if (String(marked) !== String(source.at)) {
      source.at = marked;
      if (marked && state.playing && (marked[0] - 1 < source.top || marked[0] > source.top + source.inSight)) {
        source.scroll(marked[0] - source.inSight / 3);
      } else source.draw();
    }
  }

  /** Draw the tool, the scale and the axes over the path. */
  function over(colours) {
    const canvas = element("over"), dpr = devicePixelRatio, w = canvas.clientWidth, h = canvas.clientHeight, pen = canvas.getContext("2d");
    [canvas.width, canvas.height] = [Math.round(w * dpr), Math.round(h * dpr)];
    pen.setTransform(dpr, 0, 0, dpr, 0, 0);
    for (const [t, colour, size] of [[state.hover, shade("ink"), 4], [state.at, shade("accent"), 6]]) {
      if (t === null) continue;
      const [x, y] = scene.project(...place(t));
      pen.strokeStyle = colour;
      pen.fillStyle = shade("paper");
      pen.lineWidth = 2;
      pen.beginPath();
      pen.arc(x, y, size, 0, 7);
      pen.fill();
      pen.stroke();
    }
    const ten = 10 ** Math.floor(Math.log10(110 / scene.scale)), bar = [5, 2, 1].map(k => k * ten).find(each => each * scene.scale <= 110);
    pen.strokeStyle = pen.fillStyle = colours.faint;
    pen.lineWidth = 1.5;
    pen.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    pen.beginPath();
    pen.moveTo(84, h - 20);
    pen.lineTo(84, h - 16);
    pen.lineTo(84 + bar * scene.scale, h - 16);
    pen.lineTo(84 + bar * scene.scale, h - 20);
    pen.stroke();
    pen.fillText(digits(bar, 6) + " mm", 88, h - 22);
    const turn = scene.turn();
    for (const k of [0, 1, 2].sort((a, b) => turn[3 * a + 2] - turn[3 * b + 2])) {
      const [x, y] = [turn[3 * k], turn[3 * k + 1]];
      if (Math.hypot(x, y) < 0.05) continue;
      pen.strokeStyle = pen.fillStyle = ["#c0504d", "#5a9a5a", "#4f81bd"][k];
      pen.beginPath();
      pen.moveTo(38, h - 38);
      pen.lineTo(38 + 22 * x, h - 38 - 22 * y);
      pen.stroke();
      pen.fillText("XYZ"[k], 38 + 30 * x - 4, h - 34 - 30 * y);
    }
  }

  function legend() {
    const [low, high] = range(), pen = element("legend-bar").getContext("2d"), fill = pen.createLinearGradient(0, 0, 160, 0);
    ramp().forEach((colour, k) => fill.addColorStop(k / 7, colour));
    pen.fillStyle = fill;
    pen.fillRect(0, 0, 160, 10);
    element("legend-name").textContent = NAMES[state.channel];
    element("legend-low").textContent = digits(low, 3);
    element("legend-high").textContent = digits(high, 3);
  }

  /** Return the strokes within spans of time, which the scene draws over the others. */
  function strokesOf(spans) {
    const out = [];
    for (const [from, to] of spans) {
      let i = Math.max(upTo(strokes.t, from) - 1, 0);
      for (let here = from; here < to && i + 1 < strokes.n && out.length < 16 * 40000; i++) {
        const next = Math.min(strokes.t[i + 1], to);
        if (next > here) out.push(...place(here), 0, 0, 0, 0, NO_DASH, ...place(next), 0, 0, 0, 0, NO_DASH);
        here = next;
      }
    }
    return out.length ? new Float32Array(out) : null;
  }

  function chooseLine(file, line) {
    source.open(file);
    element("files").value = file;
    const spans = source.times.spans(line), at = spans.length ? work(spans[0][0]) : {first: line, last: line};
    source.choose(at.first, at.last);
    scene.choose(strokesOf(spans));
    if (spans.length) state.at = spans[0][0];
    redraw();
  }

  function chooseTime(t) {
    const at = work(t);
    if (at) {
      source.open(at.file);
      element("files").value = at.file;
      source.choose(at.first, at.last);
      scene.choose(strokesOf(source.times.spans(at.first)));
    }
    state.at = t;
    redraw();
  }

  function tip(t, x, y) {
    const box = element("tip");
    box.hidden = t === null;
    if (t === null) return;
    const {head, rest} = describe(t);
    box.textContent = head + "\n" + rest;
    const within = element("scene");
    box.style.left = Math.max(Math.min(x + 14, within.clientWidth - box.offsetWidth - 4), 0) + "px";
    box.style.top = Math.max(Math.min(y + 14, within.clientHeight - box.offsetHeight - 4), 0) + "px";
  }

  Object.assign(model, {scene, graph, source, state, place, redraw, draw, tip, chooseTime});
  model.press = pressed => {
    if (pressed.channel !== undefined) state.channel = Number(pressed.channel);
    if (pressed.view) scene.look(pressed.view);
    for (const button of document.querySelectorAll("#colours button")) {
      button.setAttribute("aria-pressed", String(Number(button.dataset.channel) === state.channel));
    }
    redraw();
  };
  const flat = extent[2][1] - extent[2][0] < 0.01 * model.size;
  model.home = about.lathe ? "front" : flat ? "top" : "3d";
  scene.look(model.home);
  model.press({channel: 0});
  handle(model);
  draw();
  // Wait until the picture is drawn, not only requested.
  if (scene.gl) scene.gl.readPixels(0, 0, 1, 1, scene.gl.RGBA, scene.gl.UNSIGNED_BYTE, new Uint8Array(4));
  document.documentElement.dataset.opened = performance.now().toFixed(0);
  return model;
}
