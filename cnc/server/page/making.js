// Simple jobs without CAM: a form for each, whose program goes into the library and is checked.

import {Refused, attempt, get, post, visible} from "./api.js";
import {askYes} from "./asking.js";
import * as editing from "./editing.js";
import * as jobs from "./jobs.js";
import {keep, kept} from "./parts.js";
import {t, word} from "./texts.js";

const element = id => document.getElementById(id);
/** Sketches by job: the part, the ways of the tool, and the places of its zero. X to the right, Y up. */
const SKETCHES = {
  "surfacing": ["M30 6h60v50h-60z", "M18 14h84v10h-84v10h84v10h-84v8h84", [30, 56]],
  "rectangular-pocket": ["M14 4h92v56h-92zM30 14v36h60v-36z", "M38 22h44v20h-44zM50 32h20", [30, 50]],
  "round-pocket": ["M14 4h92v56h-92zM84 32a24 24 0 1 0 -48 0a24 24 0 1 0 48 0z", "M76 32a16 16 0 1 0 -32 0a16 16 0 1 0 32 0zM67 32a7 7 0 1 0 -14 0a7 7 0 1 0 14 0z", [60, 32]],
  "slot": ["M14 4h92v56h-92zM32 32a10 10 0 0 0 10 10h36a10 10 0 0 0 0 -20h-36a10 10 0 0 0 -10 10z", "M42 32h36m-6 -4l6 4l-6 4", [42, 32]],
  "hole-grid": ["M14 4h92v56h-92z", "M35 46a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M63 46a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M91 46a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M35 20a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M63 20a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M91 20a3 3 0 1 0 -6 0a3 3 0 1 0 6 0", [32, 46]],
  "hole-circle": ["M14 4h92v56h-92z", "M83 32a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M73 49a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M53 49a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M43 32a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M53 15a3 3 0 1 0 -6 0a3 3 0 1 0 6 0M73 15a3 3 0 1 0 -6 0a3 3 0 1 0 6 0", [60, 32]],
  "text": ["M14 4h92v56h-92z", "M26 46l12 -28l12 28M30 36h16M60 18v28h9a7 7 0 0 0 0 -14h-9h8a7 7 0 0 0 0 -14zM96 22a10 12 0 1 0 0 20", [26, 46]],
};

let kinds = [];

export async function begin() {
  kinds = await get("simple-jobs");
  element("make").hidden = !kinds.length;
  if (!kinds.length) return;
  element("make-kind").replaceChildren(...kinds.map(({kind, title}) => new Option(word(title), kind)));
  element("make-kind").addEventListener("change", showForm);
  element("make-form").addEventListener("submit", event => {
    event.preventDefault();
    attempt(write);
  });
  showForm();
}

function showForm() {
  const {kind, parameters} = kinds.find(each => each.kind === element("make-kind").value), values = kept(`make-${kind}`) ?? {};
  element("make-sketch").replaceChildren(sketch(...SKETCHES[kind]));
  element("make-name").value = `${kind}.nc`;
  element("make-fields").replaceChildren(...parameters.map(({name, title, default: usual, type}) => {
    const field = document.createElement("label"), isText = type === "text", label = word(title);
    const input = Object.assign(document.createElement("input"), {name, required: true, value: values[name] ?? usual, type: isText ? "text" : "number"});
    if (!isText) input.step = type === "integer" ? "1" : "any";
    if (isText) input.maxLength = 200;
    field.append(`${label[0].toUpperCase()}${label.slice(1)} `, input);
    return field;
  }));
}

/** Return a picture: a part, the ways of the tool or the probe, and a place that is marked. */
export function sketch(part, ways, [x, y]) {
  const svg = (kind, attributes) => {
    const made = document.createElementNS("http://www.w3.org/2000/svg", kind);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    return made;
  };
  const picture = svg("svg", {viewBox: "0 0 120 64", class: "sketch", "aria-hidden": "true"});
  picture.append(svg("path", {d: part, class: "part", "fill-rule": "evenodd"}), svg("path", {d: ways, class: "way"}), svg("circle", {cx: x, cy: y, r: 5, class: "probe"}));
  return picture;
}

async function write() {
  const {kind, parameters} = kinds.find(each => each.kind === element("make-kind").value), entries = new FormData(element("make-form"));
  const values = Object.fromEntries(parameters.map(({name, type}) => [name, type === "text" ? entries.get(name) : Number(entries.get(name))]));
  const name = element("make-name").value.trim(), body = {name, parameters: values};
  if (!await editing.leave()) return;
  keep(`make-${kind}`, values);
  try {
    await post(`simple-jobs/${kind}`, body);
  } catch (error) {
    if (!(error instanceof Refused) || error.finding.code !== "job-exists") throw error;
    if (!await askYes(t`Replace ${visible(name)}?`, t`Replace`)) return;
    await post(`simple-jobs/${kind}`, {...body, replace: true});
  }
  element("make").open = false;
  await jobs.openNew(name);
}
