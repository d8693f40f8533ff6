// Height maps: the choice for a job, and the form that probes a grid.

import {attempt, get, on, post} from "./api.js";
import {say} from "./machine.js";

const element = id => document.getElementById(id);

/** Return the name of the chosen height map, or null. */
export const chosen = () => element("height-map").value || null;

export async function begin() {
  element("grid-form").addEventListener("submit", event => {
    event.preventDefault();
    const found = new FormData(element("grid-form")), number = name => Number(found.get(name));
    const grid = {
      x: [number("x0"), number("x1")], y: [number("y0"), number("y1")],
      step: number("step"), clear: number("clear"), depth: number("depth"), feed: number("feed"),
      zero: found.has("zero"), system: element("system").value,
    };
    attempt(() => post(`height-maps/${encodeURIComponent(found.get("name"))}/probe`, grid));
  });
  on("height-map", ({name}) => attempt(async () => {
    await list();
    say(`height map ${name} is in the library`, {isNote: true});
  }));
  await list();
}

async function list() {
  const names = await get("height-maps"), before = chosen(), select = element("height-map");
  select.replaceChildren(new Option("none", ""), ...names.map(name => new Option(name)));
  if (names.includes(before)) select.value = before;
}
