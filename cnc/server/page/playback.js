// Playback of the path in the picture, at any speed, with a slider of its time. It moves no machine.

import {emit, on} from "./api.js";
import {t} from "./texts.js";

const element = id => document.getElementById(id);
const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 20, 50, 100, 500];

let end = 0, time = null, lineAt = () => 0, changed = () => {}, before = 0, line = 0;

/** Return the time of the path that is shown, s; null for the whole path. */
export const shownTime = () => time;

/** `redraw` is called after a change of the time. */
export function begin(redraw) {
  changed = redraw;
  element("play-speed").replaceChildren(...SPEEDS.map(each => new Option(`${each} ×`, each, each === 1, each === 1)));
  element("play").addEventListener("click", () => {
    if (isPlaying()) pause();
    else {
      if (time === null || time >= end) set(0);
      element("play").setAttribute("aria-pressed", "true");
      showButton();
      before = performance.now();
      requestAnimationFrame(step);
    }
  });
  element("play-time").addEventListener("input", event => set(Number(event.target.value)));
  element("play-all").addEventListener("click", whole);
  // What the machine does is never hidden by a playback.
  on("state", ({state}) => { if (time !== null && ["running", "held", "door"].includes(state)) whole(); });
}

/** Take another path: its duration in s, 0 for none, and the line at a time. */
export function take(duration, lineOf) {
  whole();
  [end, lineAt] = [duration, lineOf];
  element("playback").hidden = !(end > 0);
  element("play-time").max = end || 1;
  show();
}

const isPlaying = () => element("play").getAttribute("aria-pressed") === "true";

function pause() {
  element("play").setAttribute("aria-pressed", "false");
  showButton();
}

function step(now) {
  if (!isPlaying()) return;
  set(Math.min(time + (now - before) / 1000 * Number(element("play-speed").value), end));
  before = now;
  if (time >= end) pause();
  else requestAnimationFrame(step);
}

function set(value) {
  time = value;
  show();
}

/** Show the whole path again. */
function whole() {
  pause();
  if (time === null) return;
  time = null;
  show();
}

function showButton() {
  element("play").querySelector("use").setAttribute("href", `/page/icons.svg#${isPlaying() ? "pause" : "play"}`);
}

function show() {
  element("play-time").value = time ?? end;
  element("play-all").hidden = time === null;
  const now = time === null ? 0 : lineAt(time);
  element("play-shown").textContent = time === null ? `${end.toFixed(1)} s` : `${time.toFixed(1)} s${now ? t`, line ${now}` : ""}`;
  if (now !== line) emit({event: "played", line: line = now});
  changed();
}
