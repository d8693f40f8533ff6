// Probing: the cycles, and the height maps.

import {attempt, get, on, post} from "./api.js";
import {say} from "./machine.js";

const element = id => document.getElementById(id);
const BY_HAND = ["go_to", "trace_outline"];  // moves that have buttons of their own
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
    say(`height map ${name} is in the library`, {isNote: true});
  }));
  const place = ({name}) => FIRST.includes(name) ? FIRST.indexOf(name) : FIRST.length;
  for (const cycle of (await get("probing")).sort((a, b) => place(a) - place(b))) if (!BY_HAND.includes(cycle.name)) {
    element(cycle.name.startsWith("tool") ? "tool-cycles" : "cycles").append(card(cycle));
  }
  await list();
}

async function list() {
  const names = await get("height-maps"), before = chosen(), select = element("height-map");
  select.replaceChildren(new Option("none", ""), ...names.map(name => new Option(name)));
  if (names.includes(before)) select.value = before;
}

/** Return the card of a cycle. */
function card(cycle) {
  const place = document.createElement("section"), form = document.createElement("form"), title = document.createElement("h2"), go = document.createElement("button");
  place.className = "card";
  form.className = "fields";
  title.textContent = cycle.title;
  for (const {name, title: label, default: value} of cycle.parameters) {
    const field = document.createElement("label"), input = Object.assign(document.createElement("input"), {type: "number", step: "any", name, value});
    field.append(`${label} `, input);
    form.append(field);
  }
  go.type = "submit";
  go.dataset.needs = "link control board free unlocked";
  go.textContent = `Run ${cycle.name}`;
  form.append(go);
  form.addEventListener("submit", event => {
    event.preventDefault();
    const parameters = Object.fromEntries([...new FormData(form)].map(([name, value]) => [name, Number(value)]));
    attempt(() => post(`probing/${encodeURIComponent(cycle.name)}/run`, {parameters}));
  });
  place.append(title, form);
  return place;
}
