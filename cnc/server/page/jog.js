// Jogs: the pad, the keys and the gamepad. Each jog ends with its release, the focus, and the connection.

import {attempt, on, post, tell} from "./api.js";
import {machine, needs, say, state} from "./machine.js";
import {icon} from "./parts.js";
import {t, word} from "./texts.js";

const element = id => document.getElementById(id);
const STEPS = [["continuous", 0], ["0.01", 0.01], ["0.1", 0.1], ["1", 1], ["10", 10], ["50", 50]];
const PAD = [["x", -1, "y", 1], ["y", 1], ["x", 1, "y", 1], null, ["z", 1],
  ["x", -1], null, ["x", 1], null, null,
  ["x", -1, "y", -1], ["y", -1], ["x", 1, "y", -1], null, ["z", -1]];
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
  for (const parts of PAD) {
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
