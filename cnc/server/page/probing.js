// Probing: the cycles, and the height maps.

import {attempt, get, on, post} from "./api.js";
import {say} from "./machine.js";
import {sketch} from "./making.js";
import {t, word} from "./texts.js";

const element = id => document.getElementById(id);
const BY_HAND = ["go_to", "trace_outline"];  // moves that have buttons of their own
/** Sketches by cycle: the part, the ways of the probe, and the middle of the probe where it starts. X to the right, Y or Z up. */
const SKETCHES = {
  probe_z: ["M30 44h60v12h-60z", "M60 14v24m-5 -6l5 6l5 -6", [60, 12]],
  tool_length: ["M50 40h20v16h-20z", "M60 14v20m-5 -6l5 6l5 -6", [60, 12]],
  probe_edge_x: ["M64 8h46v48h-46z", "M26 32h32m-6 -5l6 5l-6 5", [24, 32]],
  probe_edge_y: ["M30 6h60v24h-60z", "M60 54v-18m-5 6l5 -6l5 6", [60, 56]],
  probe_corner: ["M56 6h54v34h-54z", "M30 22h20m-6 -5l6 5l-6 5M76 58v-12m-5 6l5 -6l5 6M30 54v-32M30 54h46", [30, 54]],
  probe_angle: ["M14 14l92 -10v24l-92 10z", "M34 58v-19m-5 6l5 -6l5 6M88 52v-19m-5 6l5 -6l5 6M34 58h54", [34, 58]],
  probe_hole: ["M20 4h80v56h-80zM82 32a22 22 0 1 0 -44 0a22 22 0 1 0 44 0z", "M60 32h18m-5 -4l5 4l-5 4M60 32h-18m5 -4l-5 4l5 4M60 32v18m-4 -5l4 5l4 -5M60 32v-18m-4 5l4 -5l4 5", [60, 32]],
};
const FIRST = ["probe_z", "probe_corner"];         // the most used cycles

/** Return the name of the chosen height map, or null. */
export const chosen = () => element("height-map").value || null;

export async function begin() {
  element("grid-form").addEventListener("submit", event => {
    event.preventDefault();
    const entries = new FormData(element("grid-form")), number = name => Number(entries.get(name));
    const grid = {
      x: [number("x0"), number("x1")], y: [number("y0"), number("y1")],
      step: number("step"), clear: number("clear"), depth: number("depth"), feed: number("feed"),
      zero: entries.has("zero"), system: element("system").value,
    };
    attempt(() => post(`height-maps/${encodeURIComponent(entries.get("name"))}/probe`, grid));
  });
  on("height-map", ({name}) => attempt(async () => {
    await list();
    say(t`height map ${name} is in the library`, {isNote: true});
  }));
  const place = ({name}) => FIRST.includes(name) ? FIRST.indexOf(name) : FIRST.length;
  for (const cycle of (await get("probing")).sort((a, b) => place(a) - place(b))) if (!BY_HAND.includes(cycle.name)) {
    element(cycle.name.startsWith("tool") ? "tool-cycles" : "cycles").append(card(cycle));
  }
  await list();
}

async function list() {
  const names = await get("height-maps"), before = chosen(), select = element("height-map");
  select.replaceChildren(new Option(t`none`, ""), ...names.map(name => new Option(name)));
  if (names.includes(before)) select.value = before;
}

/** Return the card of a cycle. */
function card(cycle) {
  const place = document.createElement("section"), form = document.createElement("form"), title = document.createElement("h2"), go = document.createElement("button");
  place.className = "card";
  form.className = "fields";
  title.textContent = word(cycle.title);
  for (const {name, title: label, default: value, choices} of cycle.parameters) {
    const field = document.createElement("label"), input = document.createElement(choices.length ? "select" : "input");
    if (choices.length) input.append(...choices.map(([number, text]) => new Option(word(text), number)));
    else Object.assign(input, {type: "number", step: "any"});
    Object.assign(input, {name, value});
    field.append(`${word(label)} `, input);
    form.append(field);
  }
  go.type = "submit";
  go.dataset.needs = "link control board free unlocked";
  go.textContent = t`Run ${cycle.name}`;
  form.append(go);
  form.addEventListener("submit", event => {
    event.preventDefault();
    const parameters = Object.fromEntries([...new FormData(form)].map(([name, value]) => [name, Number(value)]));
    attempt(() => post(`probing/${encodeURIComponent(cycle.name)}/run`, {parameters}));
  });
  place.append(title, ...cycle.name in SKETCHES ? [sketch(...SKETCHES[cycle.name])] : [], form);
  return place;
}
