// The machine: position, connection, jog, zero, overrides, hold and stop, dialogs.

import {attempt, get, giveControl, inControl, on, post, takeControl, tell} from "./api.js";
import {askNumber} from "./asking.js";
import {explain, showNeeds} from "./needs.js";

const element = id => document.getElementById(id);
const STEPS = [["continuous", 0], ["0.01", 0.01], ["0.1", 0.1], ["1", 1], ["10", 10], ["50", 50]];
const PAD = [["x", -1, "y", 1], ["y", 1], ["x", 1, "y", 1], null, ["z", 1],
  ["x", -1], null, ["x", 1], null, null,
  ["x", -1, "y", -1], ["y", -1], ["x", 1, "y", -1], null, ["z", -1]];
const ARROWS = {"x-1": "X −", "x1": "X +", "y1": "Y +", "y-1": "Y −", "z1": "Z +", "z-1": "Z −"};
const KEY_MAP = [["ArrowRight", {x: 1}, "X +"], ["ArrowLeft", {x: -1}, "X −"], ["ArrowUp", {y: 1}, "Y +"], ["ArrowDown", {y: -1}, "Y −"],
  ["PageUp", {z: 1}, "Z +"], ["PageDown", {z: -1}, "Z −"]];
const KEEP = 60;  // ms between two signs of life of a jog

export let machine = {axes: {}};
export let state = {state: "disconnected", machine: {}, work: {}};
let step = 0, jog = null, offsets = {}, isOpen = false;

/** Return a number with three decimals and a true minus sign. */
export const shown = value => value === undefined || value === null ? "–" : value.toFixed(3).replace("-", "\u2212");

/** Show a message to the operator. */
export function say(text, {isNote = false} = {}) {
  const place = element("message");
  place.hidden = !text;
  place.className = isNote ? "note" : "";
  element("message-text").textContent = worded(text);
}

/** Show what can work now. */
export const needs = () => showNeeds({isOpen, mine: inControl(), state});

/** Return a text of the server in the words of the page instead of the command line's. */
export const worded = text => text.replace(/--from-line (\d+)/g, "\u201cFrom line\u201d $1").replace(/--trust-position/g, "\u201ctrust the position\u201d")
  .replace(/--home(?= |,|$)/gm, "\u201chome first\u201d").replace(/, or cncrun home\b/g, "").replace(/, cncrun home alone\b/g, ", the button Home alone")
  .replace(/--height-map\b/g, "a height map").replace(/--stock /g, "the stock ");

export async function begin() {
  machine = await get("machine");
  element("machine-name").textContent = document.title = machine.name;
  for (const name of machine.boards) element("board").append(new Option(name));
  if (machine.boards.includes(machine.board)) element("board").value = machine.board;
  for (const name of machine.systems) element("system").append(new Option(name));
  makeReadout();
  makeJog();
  makeKeys();
  buttons();
  explain(say);
  on("hello", event => {
    offsets = event.offsets;
    showHolder(event.holder);
    showState(event.state);
    if (event.dialog) ask(event.dialog);
    else closeQuestion();
  });
  on("state", showState);
  on("control", event => showHolder(event.holder));
  on("offsets", event => { offsets = event.offsets; });
  on("dialog", ask);
  on("dialog-closed", event => { if (String(event.id) === element("question").dataset.id) closeQuestion(); });
  on("alarm", ({finding}) => say([finding.line ? `line ${finding.line}: ${finding.message}` : finding.message, finding.hint].filter(Boolean).join("\n")));
  on("notice", ({finding}) => say([finding.message, finding.hint].filter(Boolean).join("\n"), {isNote: true}));
  on("link", ({open}) => {
    if (!open) {
      jog = null;
      say("the connection to the server is lost; trying again");
      element("state").textContent = "no server";
    } else if (!isOpen) say("");
    isOpen = open;
    needs();
  });
  needs();
}

function makeReadout() {
  const body = element("readout").tBodies[0];
  for (const letter of Object.keys(machine.axes)) {
    const row = body.insertRow(), head = document.createElement("th"), unit = "abc".includes(letter) ? "degrees" : "mm";
    head.scope = "row";
    head.textContent = letter.toUpperCase();
    row.append(head);
    for (const kind of ["work", "machine"]) {
      const cell = row.insertCell();
      cell.id = `${kind}-${letter}`;
      cell.title = unit;
      cell.textContent = "–";
    }
    const cell = row.insertCell();
    cell.append(
      button("0", `Zero ${letter.toUpperCase()} here`, () => zero({[letter]: 0})),
      button("½", `Halve ${letter.toUpperCase()}`, () => zero({[letter]: 0}, true)),
      button("=", `Set ${letter.toUpperCase()} to a value`, () => {
        askNumber(`Work position of ${letter.toUpperCase()} here`, unit).then(value => { if (value !== null) zero({[letter]: value}); });
      }),
    );
  }
}

function button(text, label, action, needed = "link control board free") {
  const made = document.createElement("button");
  made.type = "button";
  made.dataset.needs = needed;
  made.textContent = text;
  made.setAttribute("aria-label", label);
  made.title = label;
  made.addEventListener("click", action);
  return made;
}

const zero = (axes, half = false) => attempt(() => post("zero", {axes, system: state.system ?? "G54", half}));

function makeJog() {
  for (const [name, distance] of STEPS) {
    const label = document.createElement("label"), input = document.createElement("input");
    input.type = "radio";
    input.name = "step";
    input.checked = distance === step;
    input.addEventListener("change", () => { step = distance; });
    label.append(input, distance ? `${name} mm` : name);
    element("steps").append(label);
  }
  for (const parts of PAD) {
    if (parts === null || parts.some((each, k) => k % 2 === 0 && !(each in machine.axes))) {
      element("pad").append(document.createElement("span"));
      continue;
    }
    const directions = Object.fromEntries(parts.flatMap((each, k) => k % 2 ? [] : [[each, parts[k + 1]]]));
    const text = Object.entries(directions).map(([letter, sign]) => ARROWS[letter + sign]).join("\n");
    const made = button(text, `Jog ${text.replace("\n", " ").replaceAll("−", "minus").replaceAll("+", "plus")}`, () => {}, "link control board free unlocked homed");
    made.addEventListener("pointerdown", event => {
      made.setPointerCapture(event.pointerId);
      made.classList.add("down");
      press(directions);
    });
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) made.addEventListener(kind, () => {
      made.classList.remove("down");
      release();
    });
    // A click of the keyboard: one step, never a continuous jog that nothing would end.
    made.addEventListener("keydown", event => {
      if ((event.key === "Enter" || event.key === " ") && !event.repeat) {
        event.preventDefault();
        press(directions);
      }
    });
    made.addEventListener("keyup", release);
    element("pad").append(made);
  }
  for (const kind of ["blur", "pagehide"]) addEventListener(kind, release);
  document.addEventListener("visibilitychange", () => { if (document.hidden) release(); });
  setInterval(() => { if (jog !== null && jog.number) tell({jog: jog.number}); }, KEEP);
}

/** Begin a jog: one step, or continuous until its release. */
export async function press(directions, factor = 1) {
  const feed = Number(element("jog-feed").value) * factor || null, unhomed = element("unhomed").checked;
  if (step) {
    const distances = Object.fromEntries(Object.entries(directions).map(([letter, sign]) => [letter, sign * step]));
    await attempt(() => post("jog/step", {distances, feed, unhomed}));
    return;
  }
  if (jog !== null) return;
  const mine = jog = {number: 0};
  const begun = await attempt(() => post("jog/start", {directions, feed, unhomed}));
  if (begun === null) {
    if (jog === mine) jog = null;
    return;
  }
  mine.number = begun.jog;
  // The button was released before the answer came.
  if (jog !== mine) post("jog/stop").catch(() => {});
}

/** End a continuous jog. */
export function release() {
  if (jog === null) return;
  jog = null;
  post("jog/stop").catch(() => {});
}

function makeKeys() {
  const rows = [...KEY_MAP.map(([name, , text]) => [name.replace("Arrow", "Arrow "), `jog ${text}; with Shift at full speed`]),
    ["Space", "hold"], ["Escape", "stop"], ["?", "this map"]];
  for (const [name, text] of rows) {
    const row = element("key-rows").insertRow(), head = document.createElement("th");
    head.scope = "row";
    head.textContent = name;
    row.append(head);
    row.insertCell().textContent = text;
  }
  const typing = target => target.closest("input, select, textarea, [tabindex], dialog") !== null;
  const pressed = target => target.closest("button, summary, a") !== null;  // The space bar is theirs.
  addEventListener("keydown", event => {
    if (event.key === "Escape" && !document.querySelector("dialog:modal")) {
      tell({stop: true});
      post("stop").catch(() => {});
      return;
    }
    if (typing(event.target) || event.ctrlKey || event.altKey || event.metaKey) return;
    const found = KEY_MAP.find(([name]) => name === event.key);
    if (found) {
      event.preventDefault();
      if (!event.repeat) press(found[1], event.shiftKey ? 1e6 : 1);
    } else if (event.key === " " && !pressed(event.target)) {
      event.preventDefault();
      attempt(() => post("hold"));
    } else if (event.key === "?") element("key-map").showModal();
  });
  addEventListener("keyup", event => { if (KEY_MAP.some(([name]) => name === event.key)) release(); });
  element("unhomed").addEventListener("change", needs);
  element("dismiss").addEventListener("click", () => say(""));
  element("keys").addEventListener("click", () => element("key-map").showModal());
  element("close-keys").addEventListener("click", () => element("key-map").close());
  addEventListener("gamepadconnected", () => requestAnimationFrame(readPad));
}

let padActive = "";  // the directions of the jog of the gamepad

/** Read the gamepad. A shoulder button must be held; its release ends the jog. */
function readPad() {
  const pad = [...navigator.getGamepads()].find(Boolean);
  if (!pad) {
    if (padActive) release();
    padActive = "";
    return;
  }
  const held = pad.buttons[4]?.pressed || pad.buttons[5]?.pressed, dead = 0.25;
  const [x, y, z] = [pad.axes[0] ?? 0, -(pad.axes[1] ?? 0), -(pad.axes[3] ?? 0)].map(each => Math.abs(each) > dead ? each : 0);
  // A step has its whole length, however far the stick is.
  const directions = Object.fromEntries([["x", x], ["y", y], ["z", z]].filter(([letter, value]) => value && letter in machine.axes)
    .map(([letter, value]) => [letter, Math.sign(value)]));
  const signs = held ? Object.entries(directions).flat().join(" ") : "";
  // Another direction begins when the machine is at rest: it never goes where the stick no longer points.
  if (padActive && signs !== padActive) {
    release();
    padActive = "";
  } else if (signs && !padActive && jog === null && state.state !== "jogging") {
    // A gamepad is read in the background as well: a stick moved for another window must not jog.
    if (document.hasFocus()) press(directions);
    padActive = signs;
  }
  requestAnimationFrame(readPad);
}

function buttons() {
  element("connection").addEventListener("submit", event => {
    event.preventDefault();
    const isOpen = state.state !== "disconnected";
    attempt(() => isOpen ? post("disconnect") : post("connect", {board: element("board").value, port: element("port").value || null}));
  });
  element("take").addEventListener("click", () => attempt(() => inControl() ? giveControl() : takeControl()));
  element("question-take").addEventListener("click", () => attempt(takeControl));
  element("zero-all").addEventListener("click", () => zero(Object.fromEntries(["x", "y"].filter(each => each in machine.axes).map(each => [each, 0]))));
  element("home").addEventListener("click", () => attempt(() => post("home", {axes: []})));
  element("unlock").addEventListener("click", () => attempt(() => post("unlock")));
  element("system").addEventListener("change", () => attempt(() => post("system", {system: element("system").value})));
  element("hold").addEventListener("click", () => attempt(() => post("hold")));
  element("resume").addEventListener("click", () => attempt(() => post("resume")));
  // Stop on the press, not on the click, and on both ways to the server.
  element("stop").addEventListener("pointerdown", stop);
  element("stop").addEventListener("click", stop);
  for (const [name, kind] of [["feed", "feed"], ["spindle", "spindle"]]) {
    element(`${name}-override`).addEventListener("input", event => { element(`${name}-percent`).textContent = `${event.target.value} %`; });
    element(`${name}-override`).addEventListener("change", event => attempt(() => post("override", {[kind]: Number(event.target.value)})));
  }
  element("rapid-override").addEventListener("change", event => attempt(() => post("override", {rapid: Number(event.target.value)})));
  element("yes").addEventListener("click", () => attempt(() => post("answer", {dialog: Number(element("question").dataset.id), yes: true})));
  element("no").addEventListener("click", stop);
  // A dialog covers the button, not its effect: a press where STOP stands stops.
  for (const place of document.querySelectorAll("dialog")) place.addEventListener("pointerdown", event => {
    const {left, right, top, bottom} = element("stop").getBoundingClientRect();
    if (event.target === place && event.clientX >= left && event.clientX <= right && event.clientY >= top && event.clientY <= bottom) stop();
  });
}

function stop() {
  jog = null;
  tell({stop: true});
  attempt(() => post("stop"));
}

const HELP = {
  tool: "You may jog, set a zero and probe before you go on. The spindle stops then, and the program goes on from here with the new zero.",
  stop: "You may jog, set a zero and probe before you go on. The spindle stops then, and the program goes on from here with the new zero.",
};

/** Ask the operator. The page stays usable: what the answer needs is never under the question. */
function ask(dialog) {
  const place = element("question");
  place.dataset.id = dialog.id;
  place.dataset.kind = dialog.kind;
  element("question-text").textContent = worded(dialog.text);
  element("question-help").textContent = HELP[dialog.kind] ?? "";
  element("question-steps").replaceChildren(...dialog.steps.map(each => Object.assign(document.createElement("li"), {textContent: worded(each)})));
  // The text has the focus: a key that was meant for something else must not confirm.
  if (!place.open) place.show();
  needs();
  // The moves to the line are drawn: the picture is to be seen beside the question.
  if (dialog.kind !== "restart") return;
  document.querySelector('nav button[data-part="picture"]').click();
  element("space").scrollIntoView({block: "end"});
}

function closeQuestion() {
  element("question").close();
  needs();
}

function showHolder(holder) {
  const mine = inControl();
  element("holder").textContent = mine ? "you have control" : holder ? `${holder} has control; you watch` : "nobody has control; you watch";
  element("take").textContent = mine ? "Give control up" : "Take control";
  element("question-take").hidden = mine;
  needs();
}

const seconds = value => {
  if (value === null || value === undefined) return "–";
  const whole = Math.round(value);
  return whole >= 3600 ? `${Math.floor(whole / 3600)}:${String(Math.floor(whole / 60) % 60).padStart(2, "0")}:${String(whole % 60).padStart(2, "0")}`
    : `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
};

/** Show a text: one that stands already costs no layout, ten times a second. */
const write = (place, text) => { if (place.textContent !== String(text)) place.textContent = text; };

function showState(event) {
  state = event;
  const badge = element("state"), text = event.held ? `${event.state}: ${event.held}` : event.state;
  write(badge, text);
  badge.dataset.state = event.state;
  element("operate").dataset.connected = event.state !== "disconnected";
  for (const kind of ["work", "machine"]) for (const letter of Object.keys(machine.axes)) {
    write(element(`${kind}-${letter}`), shown(event[kind][letter]));
  }
  write(element("system-name"), event.system);
  if (document.activeElement !== element("system")) element("system").value = event.system;
  const waits = event.pending > 0 ? ` (${Math.round(event.overrides.feed)} % in ${event.pending.toFixed(1)} s at most)` : "";
  write(element("feed"), (event.feed === null ? "–" : `${Math.round(event.feed)} mm/min`) + waits);
  write(element("spindle"), event.spindle === null ? "–" : `${Math.round(event.spindle)} rev/min`);
  write(element("tool"), event.tool ?? "–");
  write(element("line"), event.line ? `${event.line}: ${event.text}` : "–");
  write(element("left"), seconds(event.left));
  write(element("modes"), event.modes || "defaults of a program");
  write(element("buffer"), event.buffered ?? "–");
  write(element("connect"), event.board ? "Disconnect" : "Connect");
  // Another client may have connected another board than the one that is chosen here.
  element("board").disabled = element("port").disabled = event.board !== "";
  if (event.board) element("board").value = event.board;
  needs();
  for (const name of ["feed", "spindle"]) if (document.activeElement !== element(`${name}-override`)) {
    element(`${name}-override`).value = event.overrides[name];
    write(element(`${name}-percent`), `${Math.round(event.overrides[name])} %`);
  }
  if (document.activeElement !== element("rapid-override")) element("rapid-override").value = event.overrides.rapid;
  const lamps = Object.entries({...event.inputs, ...Object.fromEntries(Object.entries(event.homed).map(([letter, is]) => [`${letter.toUpperCase()} homed`, is]))});
  const list = element("lamps");
  if (list.children.length !== lamps.length) list.replaceChildren(...lamps.map(() => document.createElement("li")));
  for (const [k, [name, active]] of lamps.entries()) {
    const item = list.children[k];
    write(item, `${name}: ${active ? "on" : "off"}`);
    item.classList.toggle("active", active && !name.endsWith("homed"));
  }
}
