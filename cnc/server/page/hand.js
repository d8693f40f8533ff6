// By hand: the zero with its undo, moves to places, the outline of the cuts, spindle and coolant, entered lines, macros.

import {attempt, get, on, post, visible} from "./api.js";
import {askYes} from "./asking.js";
import {editMacro} from "./editing.js";
import * as jobs from "./jobs.js";
import {machine, needs, rotations, say, shown, state} from "./machine.js";
import {icon, keep, kept} from "./parts.js";
import {cutBox} from "./picture.js";
import {t} from "./texts.js";

const element = id => document.getElementById(id);
const MOST_UNDO = 20;
const BELOW_TOP = 3;      // mm below the top of the travel: clear of the switch
const SAME = 0.0015;      // mm; a board reports its offsets to a thousandth

let changes = [], last = null, places = [];
let undoing = false;      // the next change of an offset is that of an undo

export function begin() {
  element("zero-all").addEventListener("click", () => setZero(Object.fromEntries(["x", "y"].filter(each => each in machine.axes).map(each => [each, 0]))));
  element("undo-zero").addEventListener("click", () => attempt(undoZero));
  on("hello", event => { last = event.state.board ? event.offsets : null; });
  on("offsets", event => noteChange(event.offsets));
  on("state", ({board}) => { if (!board) [changes, last] = [[], null]; });
  element("straight").addEventListener("click", () => attempt(() => post("mdi", {line: `G10 L2 P${machine.systems.indexOf(state.system) + 1} R0`})));
  showUndo();
  movesToPlaces();
  spindleAndCoolant();
  entered();
}

// The zero. Each change of an offset is noted, also one by a probing cycle or an entered line, and can be undone.

/** Set the work position of axes at the present place. */
export const setZero = axes => attempt(() => post("zero", {axes, system: state.system}));

/** Halve the work position of an axis. */
export const halve = letter => attempt(() => post("zero", {axes: {[letter]: 0}, system: state.system, half: true}));

function noteChange(now) {
  for (const [system, place] of Object.entries(undoing ? {} : last ?? {})) {
    const letters = Object.keys(place).filter(letter => Math.abs((now[system]?.[letter] ?? place[letter]) - place[letter]) > SAME);
    if (letters.length && system !== "G92") changes.push({system, letters, before: place, after: now[system]});
  }
  changes = changes.slice(-MOST_UNDO);
  last = now;
  undoing = false;
  showUndo();
}

function showUndo() {
  const {system, letters} = changes.at(-1) ?? {}, place = element("undo-zero");
  place.dataset.count = changes.length;
  place.querySelector("span").textContent = system ? t`Undo ${system} ${letters.join("").toUpperCase()}` : t`Undo zero`;
  needs();
}

/** Return lengths with X and Y turned by degrees, counter-clockwise. */
export function turned(values, degrees) {
  const [c, s] = [Math.cos(degrees * Math.PI / 180), Math.sin(degrees * Math.PI / 180)], {x, y} = values;
  return degrees ? {...values, x: c * x - s * y, y: s * x + c * y} : values;
}

async function undoZero() {
  const {system, letters, before, after} = changes.at(-1), now = await get("offsets"), here = await get("state"), angle = rotations[system] ?? 0;
  if (letters.some(letter => Math.abs(now[system][letter] - after[letter]) > SAME)) {
    changes = [];
    showUndo();
    say(t`${system} was changed elsewhere since: nothing is undone\nsee the offsets, and set the zero again`);
    return;
  }
  // The work position to set is that of this place in the system of before. X and Y of a turned system belong together.
  const named = new Set(angle && letters.some(each => "xy".includes(each)) ? [...letters, "x", "y"] : letters);
  const way = turned(Object.fromEntries(Object.keys(before).map(letter => [letter, here.machine[letter] - before[letter]])), -angle);
  const axes = Object.fromEntries([...named].map(letter => [letter, way[letter] - (now.G92?.[letter] ?? 0)]));
  undoing = true;
  try {
    await post("zero", {axes, system});
  } catch (error) {
    undoing = false;
    throw error;
  }
  changes.pop();
  showUndo();
  say(t`${system} ${letters.join(", ").toUpperCase()} is back at its offset of before`, {isNote: true});
}

// Moves to places. Each is one activity of the server, so that a stop of any client ends the whole of it.

const named = () => `places-${machine.name}`;

/** Return the machine position of Z for a way, never below the present one; null where the operator says no. */
async function wayHeight() {
  const lift = element("lift").value;
  // The height means nothing on a machine that cannot home.
  if (lift !== "" && Object.keys(state.homed).length) return Math.max(state.machine.z, Number(lift));
  const isClear = await askYes(t`Z stays at ${shown(state.work.z)} (work): is the tool above the part and all clamps?`, t`Go`);
  return isClear ? state.machine.z : null;
}

/** Run a move by hand at the height of its way. */
async function move(cycle, parameters) {
  const height = await wayHeight();
  if (height !== null) await post(`probing/${cycle}/run`, {parameters: {...parameters, height}});
}

/** Go to a machine position of X and Y, Z raised. */
export const goTo = (x, y) => attempt(() => move("go_to", {x, y}));

function movesToPlaces() {
  const usable = ["x", "y", "z"].every(letter => letter in machine.axes) && machine.kind !== "lathe";
  for (const id of ["go-zero", "raise", "lift-note", "place-form", "outline", "outline-note", "lift-field"]) element(id).hidden = !usable;
  if (!usable) return;
  const {travel} = machine.axes.z, [low, high] = travel ?? [-Infinity, Infinity], lift = element("lift");
  const showLift = () => {
    lift.value = kept(`lift-${machine.name}`) ?? (travel ? high - BELOW_TOP : "");
    element("lift-note").textContent = t`Z goes up to machine ${lift.value === "" ? "?" : shown(Number(lift.value))} first: see Settings.`;
  };
  lift.addEventListener("change", () => {
    const value = lift.valueAsNumber;
    if (value >= low && value <= high) keep(`lift-${machine.name}`, value);
    else say(t`${lift.value || t`this`} is no height in the travel of Z\ngive a machine position from ${low} to ${high}`);
    showLift();
  });
  showLift();
  element("go-zero").addEventListener("click", () => goTo(state.zero.x, state.zero.y));
  element("raise").addEventListener("click", () => goTo(state.machine.x, state.machine.y));
  element("outline").addEventListener("click", () => attempt(traceOutline));
  places = kept(named()) ?? [];
  element("place-form").addEventListener("submit", event => {
    event.preventDefault();
    const name = element("place-name").value.trim(), {x, y} = state.machine;
    if (!name) {
      say(t`the position has no name\ngive one, such as parking`);
      return;
    }
    keep(named(), places = [...places.filter(each => each.name !== name), {name, x, y}]);
    element("place-name").value = "";
    showPlaces();
  });
  showPlaces();
}

function showPlaces() {
  element("places").replaceChildren(...places.map(({name, x, y}) => {
    const item = document.createElement("li"), text = document.createElement("span"), drop = document.createElement("button");
    const go = Object.assign(document.createElement("button"), {type: "button"});
    go.dataset.needs = "link control board free unlocked placed";
    go.append(icon("map-pin"), t`Go to ${name}`);
    go.addEventListener("click", () => goTo(x, y));
    text.textContent = t`machine X ${shown(x)}, Y ${shown(y)}`;
    drop.type = "button";
    drop.className = "icon-only";
    drop.setAttribute("aria-label", t`Forget ${name}`);
    drop.append(icon("trash"));
    drop.addEventListener("click", () => {
      keep(named(), places = places.filter(each => each.name !== name));
      showPlaces();
    });
    item.append(go, text, drop);
    return item;
  }));
  needs();
}

/** Trace the box around the cuts of the open program. It is checked again: the zero may be another one since. */
async function traceOutline() {
  if (!await jobs.checkAgain()) return;
  const box = cutBox();
  if (box === null) {
    say(t`the program has no cut that could be traced`);
    return;
  }
  const [[xLow, xHigh], [yLow, yHigh]] = box, feed = element("jog-feed").valueAsNumber;
  if (feed > 0) await move("trace_outline", {x_low: xLow, x_high: xHigh, y_low: yLow, y_high: yHigh, feed});
  else say(t`the jog has no feed\ngive one in mm/min`);
}

function spindleAndCoolant() {
  // A laser that M3 switches on would burn where it stands.
  if (["laser", "printer"].includes(machine.kind)) element("spindle-row").hidden = true;
  for (const key of document.querySelectorAll("[data-line]")) key.addEventListener("click", () => {
    const code = key.dataset.line, speed = element("hand-speed").valueAsNumber;
    if (["M3", "M4"].includes(code) && !(speed > 0)) say(t`the spindle has no speed\ngive one in rev/min`);
    else attempt(() => post("mdi", {line: ["M3", "M4"].includes(code) ? `${code} S${speed}` : code}));
  });
  element("tool-form").addEventListener("submit", event => {
    event.preventDefault();
    attempt(() => post("mdi", {line: `T${element("tool-number").valueAsNumber} M6`}));
  });
}

function entered() {
  element("mdi-form").addEventListener("submit", async event => {
    event.preventDefault();
    const line = element("mdi").value.trim();
    if (!line) return;
    if (await attempt(() => post("mdi", {line})) !== null) {
      element("mdi").value = "";
      showEntered();
    }
  });
  const list = async () => showMacros(await get("macros"));
  on("macros", () => attempt(list));
  attempt(list);
  attempt(showEntered);
}

async function showEntered() {
  const lines = await get("mdi");
  element("mdi-history").replaceChildren(...[...new Set(lines)].reverse().slice(0, 30).map(each => new Option(each)));
}

function showMacros(names) {
  element("macros").replaceChildren(...names.map(name => {
    const item = document.createElement("li"), run = Object.assign(document.createElement("button"), {type: "button"}), edit = Object.assign(document.createElement("button"), {type: "button", className: "icon-only"});
    run.dataset.needs = "link control board idle";
    run.append(icon("play"), visible(name));
    run.addEventListener("click", () => attempt(() => post(`macros/${encodeURIComponent(name)}/run`)));
    edit.dataset.needs = "link control";
    edit.setAttribute("aria-label", t`Change ${name}`);
    edit.append(icon("pencil"));
    edit.addEventListener("click", () => attempt(() => editMacro(name)));
    item.append(run, document.createElement("span"), edit);
    return item;
  }));
  if (!names.length) element("macros").append(Object.assign(document.createElement("li"), {textContent: t`There is no macro yet.`}));
  needs();
}
