// Jogs: the pad with its stick, the keys and the gamepad. Each jog ends with its release, the focus, and the connection.

import {attempt, on, post, tell} from "./api.js";
import {machine, needs, say, state} from "./machine.js";
import {icon} from "./parts.js";
import {t, word} from "./texts.js";

const element = id => document.getElementById(id);
const STEPS = [["continuous", 0], ["0.01", 0.01], ["0.1", 0.1], ["1", 1], ["10", 10], ["50", 50]];
const PAD = [["x", -1, "y", 1], ["y", 1], ["x", 1, "y", 1], null, ["z", 1],
  ["x", -1], null, ["x", 1], null, null,
  ["x", -1, "y", -1], ["y", -1], ["x", 1, "y", -1], null, ["z", -1]];
const CENTRE = 6;  // of the pad: the place of the stick
const TURNS = {"y1": 0, "x1y1": 1, "x1": 2, "x1y-1": 3, "y-1": 4, "x-1y-1": 5, "x-1": 6, "x-1y1": 7};  // eighths of a turn, clockwise from up
const KEY_MAP = [["ArrowRight", {x: 1}, "X +"], ["ArrowLeft", {x: -1}, "X −"], ["ArrowUp", {y: 1}, "Y +"], ["ArrowDown", {y: -1}, "Y −"],
  ["PageUp", {z: 1}, "Z +"], ["PageDown", {z: -1}, "Z −"]];
const KEEP = 60;  // ms between two signs of life of a jog

let step = 0, jog = null;

export function begin() {
  makeJog();
  makeKeys();
  on("link", ({open}) => { if (!open) forget(); });
}

/** Forget the jog, which ends without its signs of life. */
export function forget() {
  jog = null;
}

function makeJog() {
  for (const [name, distance] of STEPS) {
    const label = document.createElement("label"), input = document.createElement("input");
    input.type = "radio";
    input.name = "step";
    input.checked = distance === step;
    input.setAttribute("aria-label", distance ? `${name} mm` : word(name));
    input.addEventListener("change", () => { step = distance; });
    label.append(input, word(name));
    element("steps").append(label);
  }
  element("steps").append(Object.assign(document.createElement("span"), {textContent: "mm"}));
  for (const [place, parts] of PAD.entries()) {
    if (place === CENTRE && "x" in machine.axes && "y" in machine.axes) {
      element("pad").append(stickOf());
      continue;
    }
    if (parts === null || parts.some((each, k) => k % 2 === 0 && !(each in machine.axes))) {
      element("pad").append(document.createElement("span"));
      continue;
    }
    const directions = Object.fromEntries(parts.flatMap((each, k) => k % 2 ? [] : [[each, parts[k + 1]]]));
    const names = Object.entries(directions).map(([letter, sign]) => `${letter.toUpperCase()} ${sign > 0 ? t`plus` : t`minus`}`);
    const short = Object.entries(directions).map(([letter, sign]) => letter.toUpperCase() + (sign > 0 ? "+" : "\u2212"));
    const made = Object.assign(document.createElement("button"), {type: "button", title: t`Jog ${names.join(" ")}`});
    made.setAttribute("aria-label", made.title);
    made.dataset.needs = "link control board free unlocked homed";
    made.append(arrow(directions), short.length === 1 ? short[0] : "");
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

/** Return the arrow of a direction; Z has double arrows. */
function arrow(directions) {
  if ("z" in directions) return icon(directions.z > 0 ? "chevrons-up" : "chevrons-down");
  const turns = TURNS[Object.entries(directions).flat().join("")], made = icon(turns % 2 ? "arrow-up-left" : "arrow-up");
  made.dataset.turn = turns % 2 ? (turns + 1) / 2 % 4 : turns / 2;
  return made;
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
  const rows = [...KEY_MAP.map(([name, , text]) => [name.replace("Arrow", "Arrow "), t`jog ${text}; with Shift at full speed`]),
    [t`Space`, t`hold`], ["Escape", t`stop`], ["?", t`this map`]];
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
  element("keys").addEventListener("click", () => element("key-map").showModal());
  element("close-keys").addEventListener("click", () => element("key-map").close());
  addEventListener("gamepadconnected", readSticks);
}

// The sticks: that of the pad, and those of a gamepad.

const REACH = 90, DEAD = 0.15;  // px to full speed, and the part of them that is none
const SECTORS = 24, BANDS = 4;  // directions around, and speeds

let stick = null;     // how far the pad's stick is drawn, [x, y] from -1 to 1; null while nobody holds it
let followed = "";    // the direction and speed of the jog of a stick
let reading = false;

/** Return the stick in the middle of the pad. */
function stickOf() {
  const made = Object.assign(document.createElement("button"), {type: "button", tabIndex: -1, title: t`Draw this to jog X and Y: the farther, the faster`});
  made.className = "stick";
  made.setAttribute("aria-label", made.title);
  made.dataset.needs = "link control board free unlocked homed";
  made.append(icon("move"));
  let from = null;
  made.addEventListener("pointerdown", event => {
    made.setPointerCapture(event.pointerId);
    from = [event.clientX, event.clientY];
    stick = [0, 0];
    readSticks();
  });
  made.addEventListener("pointermove", event => {
    if (from === null) return;
    const [x, y] = [(event.clientX - from[0]) / REACH, (from[1] - event.clientY) / REACH], length = Math.max(Math.hypot(x, y), 1);
    stick = [x / length, y / length];
    made.style.transform = `translate(${stick[0] * REACH / 2}px, ${-stick[1] * REACH / 2}px)`;
  });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) made.addEventListener(kind, () => {
    from = stick = null;
    made.style.transform = "";
    follow(null);
  });
  return made;
}

/** Return direction and speed of a stick; null in its middle. A step has its whole length along the axes, however far it is. */
function drawn([x, y]) {
  const length = Math.hypot(x, y);
  if (length < DEAD) return null;
  const count = step ? 8 : SECTORS, turn = 2 * Math.PI / count, angle = Math.round(Math.atan2(y, x) / turn) * turn;
  const parts = [["x", Math.cos(angle)], ["y", Math.sin(angle)]].filter(([, part]) => Math.abs(part) > 1e-9);
  const directions = Object.fromEntries(parts.map(([letter, part]) => [letter, step ? Math.sign(part) : part]));
  return [directions, step ? 1 : Math.min(Math.ceil(length * BANDS), BANDS) / BANDS];
}

/** Return direction and speed of the gamepad while a shoulder button is held; null without. */
function ofGamepad(pad) {
  const held = pad.buttons[4]?.pressed || pad.buttons[5]?.pressed, dead = 0.25;
  const values = [["x", pad.axes[0] ?? 0], ["y", -(pad.axes[1] ?? 0)], ["z", -(pad.axes[3] ?? 0)]].filter(([letter, value]) => Math.abs(value) > dead && letter in machine.axes);
  return held && values.length ? [Object.fromEntries(values.map(([letter, value]) => [letter, Math.sign(value)])), 1] : null;
}

/** Jog as the sticks point, as long as somebody holds one, or there is a gamepad. */
function readSticks() {
  if (reading) return;
  reading = true;
  const read = () => {
    const pad = [...navigator.getGamepads()].find(Boolean);
    follow(stick !== null ? drawn(stick) : pad ? ofGamepad(pad) : null);
    reading = stick !== null || Boolean(pad);
    if (reading) requestAnimationFrame(read);
  };
  read();
}

/** Jog in a direction. Another one begins when the machine is at rest: it never goes where the stick no longer points. */
function follow(wanted) {
  const key = wanted === null ? "" : JSON.stringify(wanted);
  if (followed && key !== followed) {
    release();
    followed = "";
  } else if (key && !followed && jog === null && state.state !== "jogging") {
    // A gamepad is read in the background as well: a stick moved for another window must not jog.
    if (document.hasFocus()) press(...wanted);
    followed = key;
  }
}
