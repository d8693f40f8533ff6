// The machine: position, connection, overrides, hold and stop, questions to the operator.

import {attempt, get, giveControl, inControl, on, post, takeControl, tell, visible} from "./api.js";
import {askNumber} from "./asking.js";
import {halve, setZero} from "./hand.js";
import {forget} from "./jog.js";
import {explain, isPaused, showNeeds} from "./needs.js";
import {openPart, showPart} from "./parts.js";
import {detail, explained, said, t, word} from "./texts.js";

const element = id => document.getElementById(id);
const BRIEF = 6000;  // ms

export let machine = {axes: {}};
export let state = {state: "disconnected", machine: {}, work: {}};
export let rotations = {};
let isOpen = false, place = null, hasMet = false, brief = 0, holder = null;

/** Return a number with three decimals and a true minus sign. */
export const shown = value => value === undefined || value === null ? "–" : value.toFixed(3).replace("-", "\u2212");

/** Show a message to the operator, with the English text of the server; a brief one goes by itself. */
export function say(text, {isNote = false, isBrief = false, english = ""} = {}) {
  clearTimeout(brief);
  if (isBrief) brief = setTimeout(() => { element("message").hidden = true; }, BRIEF);
  const place = element("message");
  place.hidden = !text;
  place.className = isNote ? "note" : "";
  element("message-text").scrollTop = 0;
  element("message-text").replaceChildren(worded(text), ...detail(english));
}

/** Tell of a finding of the server. */
function tellOf(finding, isNote) {
  const {message, hint, detail: english} = explained(finding);
  const text = finding.line && !isNote ? t`line ${finding.line}: ${message}` : message;
  say([text, hint].filter(Boolean).join(english ? " " : "\n"), {isNote, english});
}

/** Show what can work now, and the next step where no program runs. */
export function needs() {
  showNeeds({isOpen, mine: inControl(), holder, state});
  const why = element("run").dataset.why, name = element("jobs").value;
  write(element("guide"), state.program ? `${state.line ? t`line ${state.line}: ` : ""}${state.text}` : why || (
    element("outcome").dataset.refused === "true" ? t`the check has refused ${visible(name)}: Program shows why` : t`ready: Run begins ${visible(name)}`));
}

/** Return a text of the server in the words of the page instead of the command line's. */
export const worded = text => text.replace(/--from-line\b/g, `\u201c${t`From line`}\u201d`).replace(/--trust-position/g, `\u201c${t`trust the position`}\u201d`)
  .replace(/--home(?= |,|$)/gm, `\u201c${t`home first`}\u201d`).replace(/, or cncrun home\b/g, "").replace(/, cncrun home alone\b/g, `, the button ${t`Home`} alone`)
  .replace(/--height-map\b/g, t`a height map`).replace(/--stock /g, `${t`the stock`} `);

/** Return the name of a program, or of the cycle that a line calls. */
export const named = program => visible(program.replace(/^o<(\w+)> call.*/, "$1"));

export async function begin() {
  machine = await get("machine");
  element("machine-name").textContent = document.title = machine.name;
  for (const name of machine.boards) element("board").append(new Option(name));
  if (machine.boards.includes(machine.board)) element("board").value = machine.board;
  for (const name of machine.systems) element("system").append(new Option(name));
  makeReadout();
  buttons();
  explain(say);
  on("hello", event => {
    rotations = event.rotations;
    showHolder(event.holder);
    showState(event.state);
    // Who opens the page begins where the next step is.
    if (!hasMet && !event.state.board) showPart("setup");
    hasMet = true;
    if (event.dialog) ask(event.dialog);
    else closeQuestion();
  });
  on("state", showState);
  on("job-progress", ({program, line, lines}) => { if (program === state.program && lines) place = line / lines; });
  on("control", event => showHolder(event.holder));
  on("offsets", event => { rotations = event.rotations; });
  on("dialog", ask);
  on("dialog-closed", event => { if (String(event.id) === element("question").dataset.id) closeQuestion(); });
  on("alarm", ({finding}) => tellOf(finding, false));
  on("notice", ({finding}) => tellOf(finding, true));
  on("link", ({open}) => {
    if (!open) {
      say(t`the connection to the server is lost; trying again`);
      element("state").textContent = t`no server`;
    } else if (!isOpen) say("");
    isOpen = open;
    needs();
  });
  needs();
}

function makeReadout() {
  const body = element("readout").tBodies[0];
  for (const letter of Object.keys(machine.axes)) {
    const row = body.insertRow(), head = document.createElement("th"), unit = "abc".includes(letter) ? t`degrees` : "mm", name = letter.toUpperCase();
    head.scope = "row";
    head.textContent = name;
    row.append(head);
    const work = Object.assign(document.createElement("output"), {id: `work-${letter}`, title: unit, textContent: "–"});
    const at = Object.assign(document.createElement("small"), {id: `machine-${letter}`, title: t`machine position, ${unit}`, textContent: "–"});
    const label = Object.assign(document.createElement("small"), {className: "of-machine", textContent: t`machine`});
    row.insertCell().append(work, label, " ", at);
    row.insertCell().append(
      button("0", t`Zero ${name} here`, () => setZero({[letter]: 0})),
      button("½", t`Halve ${name}`, () => halve(letter)),
      button("=", t`Set ${name} to a value`, () => {
        askNumber(t`Work position of ${name} here`, unit).then(value => { if (value !== null) setZero({[letter]: value}); });
      }),
    );
  }
}

function button(text, label, action) {
  const made = document.createElement("button");
  made.type = "button";
  made.dataset.needs = "link control board free";
  made.textContent = text;
  made.setAttribute("aria-label", label);
  made.title = label;
  made.addEventListener("click", action);
  return made;
}

function buttons() {
  element("connection").addEventListener("submit", event => {
    event.preventDefault();
    const isOpen = state.state !== "disconnected";
    attempt(async () => {
      if (isOpen) return post("disconnect");
      // Nobody is robbed of the control here, and nothing moves.
      if (!inControl()) await takeControl();
      return post("connect", {board: element("board").value, port: element("port").value || null});
    });
  });
  element("take").addEventListener("click", () => attempt(() => inControl() ? giveControl() : takeControl()));
  element("question-take").addEventListener("click", () => attempt(takeControl));
  element("home").addEventListener("click", () => attempt(() => post("home", {axes: []})));
  element("unlock").addEventListener("click", () => attempt(() => post("unlock")));
  element("system").addEventListener("change", () => attempt(() => post("system", {system: element("system").value})));
  element("dismiss").addEventListener("click", () => say(""));
  element("hold").addEventListener("click", () => attempt(() => post("hold")));
  element("resume").addEventListener("click", () => attempt(() => post("resume")));
  // Stop on the press, not on the click, and on both ways to the server.
  element("stop").addEventListener("pointerdown", stop);
  element("stop").addEventListener("click", stop);
  for (const [name, kind] of [["feed", "feed"], ["spindle", "spindle"]]) {
    element(`${name}-override`).addEventListener("input", event => { element(`${name}-percent`).textContent = `${event.target.value} %`; });
    element(`${name}-override`).addEventListener("change", event => attempt(() => post("override", {[kind]: Number(event.target.value)})));
  }
  for (const key of document.querySelectorAll("[data-override]")) key.addEventListener("click", () => {
    const range = element(`${key.dataset.override}-override`);
    range.value = Number(range.value) + Number(key.dataset.by);
    for (const kind of ["input", "change"]) range.dispatchEvent(new Event(kind));
  });
  element("rapid-override").addEventListener("change", event => attempt(() => post("override", {rapid: Number(event.target.value)})));
  element("yes").addEventListener("click", () => attempt(agree));
  element("question-value").addEventListener("keydown", event => {
    if (event.key !== "Enter") return;
    event.preventDefault();
    element("yes").click();
  });
  element("no").addEventListener("click", stop);
  // A dialog covers the button, not its effect: a press where STOP stands stops.
  for (const place of document.querySelectorAll("dialog")) place.addEventListener("pointerdown", event => {
    const {left, right, top, bottom} = element("stop").getBoundingClientRect();
    if (event.target === place && event.clientX >= left && event.clientX <= right && event.clientY >= top && event.clientY <= bottom) stop();
  });
}

function stop() {
  forget();
  tell({stop: true});
  attempt(() => post("stop"));
}

/** Answer the question with yes, and with the number of a reading. */
async function agree() {
  const {id, kind} = element("question").dataset, value = element("question-value").valueAsNumber;
  if (kind === "reading" && !Number.isFinite(value)) {
    say(t`type the number first\nin mm, such as 0.043`);
    return;
  }
  await post("answer", {dialog: Number(id), yes: true, value: kind === "reading" ? value : null});
}

/** Return the text of a question, and what is to be known for it. */
function texts({kind, text: english, doubts}) {
  const told = doubts.map(explained), isEnglish = told.every(({detail}) => detail === "");
  if (doubts.length && !isEnglish) {
    const messages = doubts.map(({message}) => message).join("; ");
    return [worded([...told.map(({message}) => message), said(english.slice(messages.length + 2))].join(" ")), messages];
  }
  const text = said(english);
  if (["tool", "stop"].includes(kind)) return [worded(text), t`You may jog, set a zero and probe before you go on. The spindle stops then, and the program goes on from here with the new zero.`];
  const lines = worded(text).split("\n");
  return kind === "reading" ? [lines.at(-1), lines.slice(0, -1).join("\n")] : [worded(text), ""];
}

/** Ask the operator. The page stays usable: what the answer needs is never under the question. */
function ask(dialog) {
  const place = element("question");
  const isNew = place.dataset.id !== String(dialog.id), reads = dialog.kind === "reading", measures = reads || dialog.kind === "todo";
  place.dataset.id = dialog.id;
  place.dataset.kind = dialog.kind;
  [element("question-text").textContent, element("question-help").textContent] = texts(dialog);
  // Below the doubts of a start stands what the server says.
  element("question-help").lang = dialog.doubts.length ? "en" : document.documentElement.lang;
  element("question-field").hidden = !reads;
  element("question-unit").textContent = "mm";
  // A number that is half typed survives a lost connection.
  if (isNew) element("question-value").value = "";
  element("yes").querySelector("span").textContent = reads ? t`Take the reading` : t`Go on`;
  element("no").querySelector("span").textContent = measures ? t`Stop the measurement` : t`Stop the program`;
  element("question-steps").replaceChildren(...dialog.steps.map(each => Object.assign(document.createElement("li"), {textContent: worded(said(each))})));
  // The text has the focus: a key that was meant for something else must not confirm.
  if (!place.open) place.show();
  // Nor must it be lost: a desk has a keyboard for the next reading, a phone would cover the page.
  if (reads && inControl() && matchMedia("(pointer: fine)").matches) element("question-value").focus();
  needs();
  // The moves to the line are drawn: the picture is to be seen beside the question.
  if (dialog.kind === "restart") showPart("run");
  // At a pause the tool is touched off: a phone shows the pad in the part Set up alone.
  else if (isPaused() && inControl() && openPart() === "run" && !element("pad").checkVisibility()) showPart("setup");
}

function closeQuestion() {
  element("question").close();
  needs();
}

function showHolder(client) {
  const mine = inControl();
  holder = client;
  element("holder").textContent = mine ? t`you have control` : holder ? t`${holder} has control; you watch` : t`nobody has control; you watch`;
  element("take").querySelector("span").textContent = mine ? t`Give control up` : t`Take control`;
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

/** Show the program that runs, how far it is, and the time that is left. */
function showProgress(event) {
  const ran = event.run_time, runs = event.program !== "";
  if (!runs) place = null;
  const part = !runs ? 0 : event.left === null ? (place ?? 0) : ran / Math.max(ran + event.left, 1e-9);
  if (element("progress").value !== part) element("progress").value = part;
  write(element("job-name"), runs ? named(event.program) : visible(element("jobs").value) || t`no program`);
  write(element("job-place"), runs ? t`line ${event.line}, ${Math.floor(100 * part)} %` : "");
  write(element("left"), seconds(event.left));
}

function showState(event) {
  state = event;
  const badge = element("state"), text = event.held ? `${word(event.state)}: ${said(event.held)}` : word(event.state);
  write(badge, text);
  badge.dataset.state = event.state;
  // Where the parts stand in a column, the connection comes first until the machine can be used.
  document.querySelector("main").dataset.ready = String(!["disconnected", "alarm"].includes(event.state) && Object.values(event.homed).every(Boolean));
  for (const kind of ["work", "machine"]) for (const letter of Object.keys(machine.axes)) {
    write(element(`${kind}-${letter}`), shown(event[kind][letter]));
  }
  const angle = event.rotation ? `\u2220 ${event.rotation.toFixed(3).replace("-", "\u2212")}\u00b0` : "";
  write(element("system-name"), [event.system, angle].filter(Boolean).join(" "));
  // Each program of a turned system goes another way: it is never in use unseen.
  element("system-name").classList.toggle("turned", angle !== "");
  element("straight").hidden = !angle;
  write(element("straight").querySelector("span"), t`Remove the rotation of ${event.system} (${angle})`);
  if (document.activeElement !== element("system")) element("system").value = event.system;
  const waits = event.pending > 0 ? t` (${Math.round(event.overrides.feed)} % in ${event.pending.toFixed(1)} s at most)` : "";
  showProgress(event);
  write(element("feed"), (event.feed === null ? "–" : `${Math.round(event.feed)} mm/min`) + waits);
  write(element("spindle"), event.spindle === null ? "–" : t`${Math.round(event.spindle)} rev/min`);
  write(element("tool"), event.tool ?? "–");
  write(element("buffer"), event.buffered ?? "–");
  write(element("tool-now"), event.tool === null ? t`not known` : event.tool || t`none`);
  write(element("modes"), event.modes || t`defaults of a program`);
  write(element("connect"), event.board ? t`Disconnect` : t`Connect`);
  element("connect").dataset.needs = event.board ? "link control" : "link offered";
  // Another client may have connected another board than the one that is chosen here.
  element("board").disabled = element("port").disabled = event.board !== "";
  if (event.board) element("board").value = event.board;
  needs();
  for (const name of ["feed", "spindle"]) if (document.activeElement !== element(`${name}-override`)) {
    element(`${name}-override`).value = event.overrides[name];
    write(element(`${name}-percent`), `${Math.round(event.overrides[name])} %`);
  }
  if (document.activeElement !== element("rapid-override")) element("rapid-override").value = event.overrides.rapid;
  const lamps = Object.entries({...event.inputs, ...Object.fromEntries(Object.entries(event.homed).map(([letter, is]) => [t`${letter.toUpperCase()} homed`, is]))});
  const list = element("lamps");
  if (list.children.length !== lamps.length) list.replaceChildren(...lamps.map(() => document.createElement("li")));
  for (const [k, [name, active]] of lamps.entries()) {
    const item = list.children[k];
    write(item, `${said(name)}: ${active ? t`on` : t`off`}`);
    item.classList.toggle("active", active && name in event.inputs);
  }
}
