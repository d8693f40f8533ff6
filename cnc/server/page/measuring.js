// Measurements of the machine's own errors: the order, and the result with its picture. Their questions stand above each part.

import {attempt, get, on, post, remove, visible} from "./api.js";
import {askYes} from "./asking.js";
import {machine, needs, say, shown} from "./machine.js";
import {sketch} from "./making.js";
import {said, t, word} from "./texts.js";

const element = id => document.getElementById(id);
const LINEAR = "xyzuvw";
const MOST_RECORD = 900_000;  // characters
/** Sketches: the part, the ways, and the gauge or the ball of the probe. X to the right, Y up. */
const SKETCHES = {
  "backlash gauge": ["M14 18h34v28h-34z", "M62 32h-10m5 -5l-5 5l5 5M20 54h28m-6 -4l6 4l-6 4M48 8h-28m6 -4l-6 4l6 4", [84, 32]],
  "backlash probe": ["M14 6l92 34v20h-92z", "M52 12v10m-4 -5l4 5l4 -5M34 8h36m-6 -4l6 4l-6 4", [52, 6]],
  "pitch gauge": ["M10 38h100v12h-100z", "M20 38v-6M36 38v-6M52 38v-6M68 38v-6M84 38v-6M100 38v-6M20 16h80m-6 -5l6 5l-6 5", [36, 26]],
  "pitch probe": ["M14 34h14v24h-14zM46 34h14v24h-14zM78 34h14v24h-14z", "M40 44h-10m5 -4l-5 4l5 4M40 40v-24h34v20m-4 -5l4 5l4 -5", [42, 44]],
  "square gauge": ["M20 6h14v38h76v14h-90z", "M48 32v10m-4 -5l4 5l4 -5M48 22h44m-6 -4l6 4l-6 4", [48, 26]],
  "square probe": ["M20 6h14v38h76v14h-90z", "M50 28v14m-4 -5l4 5l4 -5M94 28v14m-4 -5l4 5l4 -5M50 28h44M50 24h-14m5 -4l-5 4l5 4", [50, 26]],
  limits: ["M96 20h12v24h-12z", "M26 32h62m-7 -5l7 5l-7 5M88 20h-30m5 -4l-5 4l5 4M88 44h-46m5 -4l-5 4l5 4", [92, 32]],
  shaking: ["M34 14h30v40h-30z", "M70 34h26m-6 -5l6 5l-6 5M96 46h-26m6 -5l-6 5l6 5M14 34c3 -14 5 -14 7 0s4 10 6 0", [49, 22]],
  ringing: ["M10 54h100v6h-100z", "M14 32c6 -40 10 -40 14 0s8 28 12 0s6 -20 10 0s6 14 10 0s6 -10 10 0s6 6 10 0s6 -4 10 0h12", [14, 32]],
};

/** Return the measurements by kind: their names, with what is typed and with the probe. */
const kinds = () => ({
  backlash: [t`Backlash of an axis`, t`Set a gauge along the axis, with half of its way left. The axis needs 1.5 mm of room downwards.`,
    t`Clamp a straight face across both axes, at about 45 degrees. Bring the probe 3 to 8 mm in front of it; the axis needs 2 mm on either side.`],
  pitch: [t`Errors of a screw`, t`Let a scale, or a gauge on blocks of known length, show the true place. The places must cover the travel.`,
    t`Lay faces along the axis: a step gauge, or gauge blocks. Bring the probe in front of the first one, on the side from which all are touched.`],
  square: [t`Angle between two axes`, t`Lay a square on the table, its legs along the axes. Put the gauge into the spindle, at the corner of the first leg.`,
    t`Lay a square on the table, its legs along the axes. Bring the probe to the inner corner, a few mm from both legs.`],
  limits: [t`Limits by lost steps`, t`Take the tool and the work away. The axis homes, then goes out and back ever faster over most of its travel. Its limit switch shows lost steps.`],
  shaking: [t`Modes by the accelerometer of the board`, t`Fix the accelerometer to the tool or the table. The axis makes short quick moves, up to 5.5 mm, with rests of 0.7 s.`],
  ringing: [t`Modes of a frame that rings`, t`Choose the record of an accelerometer: times and accelerations, with taps or short quick moves and rests of 0.5 s. Nothing moves.`],
});

/** Return the fields of a form: name, label, value, and a kind or its choices. */
function fields(kind, probes) {
  const axes = letters(), of = letter => [[`${letter}+`, `${letter.toUpperCase()}+`], [`${letter}-`, `${letter.toUpperCase()}\u2212`]];
  const feed = ["feed", t`speed, mm/min; empty: the highest that stops in 0.2 s`, "", "optional"];
  const contacts = [["reach", t`longest way to a face, mm`, 10], ["contacts", t`contacts of a place`, 5, "integer"], ["contact_feed", t`speed of a first contact, mm/min`, 100]];
  const axis = ["axis", t`axis`, axes[0], axes.map(letter => [letter, letter.toUpperCase()])];
  if (kind === "limits") return [axis, ["most", t`highest factor of the limits in the machine file`, 2]];
  if (kind === "shaking") return [axis];
  if (kind === "ringing") return [["record", t`record (csv)`, "", "file"]];
  if (kind === "backlash") {
    return probes ? [axis, ["touch", t`direction of the touches`, "y+", axes.flatMap(of)], ["repeats", t`reversals`, 3, "integer"], ...contacts]
      : [axis, ["reverse", t`way back, mm; more than the backlash`, 0.5], ["repeats", t`reversals`, 3, "integer"], feed];
  }
  if (kind === "pitch") {
    return probes ? [axis, ["touch", t`direction of the touches`, "-", [["+", "+"], ["-", "\u2212"]]], ["faces", t`distances of the faces from the first one, mm`, "0 50 100", "numbers"], ["lift", t`way up over a face, mm`, 20], ["blocks", t`wait at each face for other blocks`, false, "check"], ...contacts]
      : [axis, ["first", t`lowest place, mm`, "first", "place"], ["last", t`highest place, mm`, "last", "place"], ["places", t`number of places`, 11, "integer"], ["both", t`come from above too: the backlash at each place`, false, "check"], feed];
  }
  const pairs = ["xy", "xz", "yz"].filter(pair => [...pair].every(letter => axes.includes(letter))).map(pair => [pair, pair.toUpperCase()]);
  const legs = [["axes", t`axes`, pairs[0]?.[0], pairs], ["length0", t`way along the first leg, mm, with its sign`, 100], ["length1", t`way along the second leg, mm, with its sign`, 100]];
  const turned = ["turned", t`turn the square over: its own error goes away`, true, "check"];
  return probes ? [...legs, turned, ["outside", t`touch the outer faces`, false, "check"], ...contacts] : [...legs, ["points_to_plus", t`the plunger points to`, "true", [["true", t`plus`], ["false", t`minus`]]], turned, feed];
}

const letters = () => Object.keys(machine.axes).filter(letter => LINEAR.includes(letter));

export async function begin() {
  const listed = kinds();
  element("measure-kind").append(...Object.entries(listed).map(([kind, [name]]) => new Option(name, kind)));
  for (const id of ["measure-kind", "measure-method"]) element(id).addEventListener("change", showForm);
  element("measure-form").addEventListener("submit", event => {
    event.preventDefault();
    attempt(order);
  });
  element("measure-write").addEventListener("click", () => attempt(write));
  element("measure-discard").addEventListener("click", () => attempt(() => remove("measurement")));
  for (const kind of ["hello", "measurement"]) on(kind, () => attempt(show));
  showForm();
}

function showForm() {
  const kind = element("measure-kind").value, texts = kinds()[kind], probes = texts.length > 2 && element("measure-method").value === "probe";
  element("measure-method-field").hidden = texts.length < 3;
  element("measure-sketch").replaceChildren(sketch(...SKETCHES[texts.length > 2 ? `${kind} ${probes ? "probe" : "gauge"}` : kind]));
  element("measure-begin").dataset.needs = kind === "ringing" ? "link control" : "link control board idle unlocked";
  element("measure-help").textContent = texts[probes ? 2 : 1];
  element("measure-fields").replaceChildren(...fields(kind, probes).map(field));
  element("measure-fields").querySelector("[name=axis]")?.addEventListener("change", places);
  places();
  needs();
}

function field([name, text, value, kind = "number"]) {
  const label = document.createElement("label"), input = document.createElement(Array.isArray(kind) ? "select" : "input");
  if (Array.isArray(kind)) input.append(...kind.map(([key, shown]) => new Option(shown, key)));
  else input.type = {check: "checkbox", file: "file", numbers: "text"}[kind] ?? "number";
  Object.assign(input, {name, required: !["optional", "check"].includes(kind)});
  input.dataset.kind = Array.isArray(kind) ? "choice" : kind;
  if (input.type === "number") input.step = kind === "integer" ? "1" : "any";
  if (kind === "file") input.accept = ".csv,.txt,text/csv";
  if (kind === "check") input.checked = value;
  else if (kind !== "file") input.value = value;
  const head = `${text[0].toUpperCase()}${text.slice(1)}`;
  if (kind === "check") {
    label.className = "check";
    label.append(input, ` ${head}`);
  } else label.append(`${head} `, input);
  return label;
}

/** Propose the ends of the travel for the places of a scale. */
function places() {
  const form = element("measure-fields"), travel = machine.axes[form.querySelector("[name=axis]")?.value]?.travel;
  if (!form.querySelector("[name=first]") || !travel) return;
  form.querySelector("[name=first]").value = travel[0] + 1;
  form.querySelector("[name=last]").value = travel[1] - 1;
}

/** Begin what the form says. */
async function order() {
  const kind = element("measure-kind").value, probes = !element("measure-method-field").hidden && element("measure-method").value === "probe", body = {}, probe = {};
  for (const input of element("measure-fields").querySelectorAll("[name]")) {
    if (input.type === "file") {
      const file = input.files[0];
      if (file.size > MOST_RECORD) {
        say(t`the record is too long\ngive one of at most ${Math.round(MOST_RECORD / 1000)} kB, such as 20 s`);
        return;
      }
      Object.assign(body, {text: await file.text(), name: file.name});
    } else if (input.dataset.kind === "numbers") body[input.name] = input.value.trim().split(/[\s;]+/).map(Number);
    else if (["touch", "reach", "contacts", "contact_feed"].includes(input.name)) probe[input.name] = input.name === "touch" ? input.value : Number(input.value);
    else if (input.type === "checkbox") body[input.name] = input.checked;
    else if (input.name === "points_to_plus") body[input.name] = input.value === "true";
    else if (input.dataset.kind === "choice") body[input.name] = input.value;
    else if (input.value !== "") body[input.name] = Number(input.value);
  }
  if (kind === "square") {
    body.lengths = [body.length0, body.length1];
    delete body.length0;
    delete body.length1;
  }
  if (!["limits", "ringing"].includes(kind)) body.unhomed = element("unhomed").checked;
  if (probes) {
    if (kind === "pitch") probe.touch = body.axis + probe.touch;
    body.probe = probe;
  }
  await post(`measure/${kind === "shaking" ? "ringing" : kind}`, body);
}

/** Show the last measurement. */
async function show() {
  const {number, kind, running, result} = await get("measurement"), place = element("measure-result"), [name] = kinds()[kind];
  place.hidden = !running && result === null;
  place.dataset.number = number;
  element("measure-title").textContent = running ? t`${name}: under way` : said(result?.title ?? "");
  element("measure-remark").textContent = running ? t`Its questions stand above. STOP ends it; nothing is written then.` : said(result?.remark ?? "");
  element("measure-picture").replaceChildren(...result ? [...bars(result.bars), ...trials(result.trials), ...modes(result.modes)] : []);
  element("measure-steps").replaceChildren(...(result?.steps ?? []).map(step => Object.assign(document.createElement("li"), {textContent: visible(said(step))})));
  element("measure-note").textContent = !result ? "" : result.written ? t`Written to ${visible(result.file)}. It takes effect when cncrun serve is started again: home the machine then.` : said(result.refusal);
  element("measure-write").hidden = !result || result.written || result.refusal !== "";
  element("measure-discard").hidden = !result;
  place.dataset.file = result?.file ?? "";
  needs();
}

/** Write the result that is shown, when it is confirmed. */
async function write() {
  const place = element("measure-result"), steps = [...element("measure-steps").children].map(each => each.textContent), number = Number(place.dataset.number);
  if (await askYes(t`Write this into ${visible(place.dataset.file)}?`, t`Write`, steps)) await post("measurement/write", {number});
}

/** Return a table; a cell is a text, or an element. */
function table(heads, rows) {
  const made = document.createElement("table"), head = made.createTHead().insertRow(), body = made.createTBody();
  for (const text of heads) head.append(Object.assign(document.createElement("th"), {scope: "col", textContent: text}));
  for (const [name, ...cells] of rows) {
    const row = body.insertRow();
    row.append(Object.assign(document.createElement("th"), {scope: "row", textContent: name}));
    for (const cell of cells) row.insertCell().append(...[cell].flat());
  }
  return made;
}

/** Return a bar to the left or right of 0. */
function bar(part, className) {
  const svg = (kind, attributes) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", kind);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  };
  const picture = svg("svg", {viewBox: "-1 0 2 1", preserveAspectRatio: "none", class: `error-bar ${className}`, "aria-hidden": "true"});
  picture.append(svg("rect", {x: Math.min(part, 0), y: 0.1, width: Math.abs(part), height: 0.8}), svg("path", {d: "M0 0v1"}));
  return picture;
}

const number = value => Object.assign(document.createElement("span"), {className: "number", textContent: `${value > 0 ? "+" : ""}${shown(value)}`});

const bars = rows => rows.length ? [table([t`error, mm`, t`before`, t`after`], rows.map(row => [
  said(row.name), [number(row.before), bar(row.before_part, "before")], [number(row.after), bar(row.after_part, "after")],
]))] : [];

const trials = rows => rows.length ? [table([t`limit`, t`value`, t`switch, mm`, t`steps`], rows.map(({name, value, unit, error, lost}) => [
  word(name), `${value.toPrecision(4)} ${unit}`, error === null ? "–" : number(error), lost ? t`lost` : t`right`,
]))] : [];

const modes = rows => rows.length ? [table([t`axis`, t`frequency, Hz`, t`damping`, t`part of the energy`], rows.map(({axis, frequency, damping, share}) => [
  axis.toUpperCase(), frequency.toFixed(2), damping.toFixed(3), `${Math.round(100 * share)} %`,
]))] : [];
