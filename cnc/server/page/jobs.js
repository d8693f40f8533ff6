// Jobs: library, upload, check with findings, program text, run.

import {attempt, get, on, post, put, remove, visible} from "./api.js";
import {askYes} from "./asking.js";
import * as editing from "./editing.js";
import {showFindings, writeLine} from "./findings.js";
import {named, needs, say} from "./machine.js";
import {showPart} from "./parts.js";
import * as picture from "./picture.js";
import * as heights from "./probing.js";
import {explained, said, t, word} from "./texts.js";

const element = id => document.getElementById(id);
const WINDOW = 500;  // lines that are fetched at a time
const ROW = 19;      // px, height of a line of text
const TALLEST = 8e6; // px; browsers end an element of more than 17 million

let waiting = null;      // called with the outcome of the check that was asked for
let uploading = false;  // the list then opens no job of its own, which would empty the fields again
let isChecked = false;   // whether the last check of the open program found no error
let chosen = 0;          // the line that is shown in the picture
let changed = 0;         // time of the text that is shown
let job = null, total = 0, now = 0, windows = new Map();

export async function begin() {
  element("jobs").addEventListener("change", () => attempt(async () => {
    if (await editing.leave()) await open(element("jobs").value);
    else element("jobs").value = job;
  }));
  element("upload").addEventListener("change", upload);
  element("check").addEventListener("click", () => attempt(() => check()));
  element("height-map").addEventListener("change", () => attempt(check));
  element("simulate").addEventListener("click", () => attempt(async () => {
    if (job === null) return;
    await post(path("/cut"), {stock: element("stock").value.trim(), resolution: null, system: element("system").value});
    element("outcome").textContent = t`cutting`;
  }));
  on("job-cut", event => { if (event.name === job) attempt(() => showCut(event)); });
  element("run").addEventListener("click", run);
  element("remove").addEventListener("click", () => {
    const mine = job;
    if (mine !== null) askYes(t`Remove ${visible(mine)} from the library?`, t`Remove`).then(yes => { if (yes) attempt(() => remove(`jobs/${encodeURIComponent(mine)}`)); });
  });
  element("text").addEventListener("scroll", showText);
  // A line that is pressed is shown in the picture; a second press ends this.
  element("lines").addEventListener("click", event => choose(Number(event.target.closest("li")?.dataset.line) || 0));
  new ResizeObserver(showText).observe(element("text"));
  element("from-line").addEventListener("input", showRun);
  on("jobs", () => attempt(list));
  on("job-checked", event => {
    if (event.name === job) attempt(async () => {
      const about = await get(path());
      // Another client may have changed the text.
      if (event.name === job && about.changed !== changed) showLength(about);
      await showCheck();
    }).finally(() => {
      waiting?.(isChecked);
      waiting = null;
    });
  });
  on("job-sketched", event => {
    if (event.name === job) attempt(async () => {
      const found = await get(path("/sketch"));
      if (event.name === job && !picture.isWhole()) await picture.show(found, job, {isWhole: false});
    });
  });
  on("job-progress", event => {
    if (event.program === job) element("outcome").textContent = event.stage === "checking"
      ? t`checking, line ${event.line}` : event.lines ? t`running, line ${event.line} of ${event.lines}` : t`running, line ${event.line}`;
  });
  on("job-ended", ended);
  let running = "";
  on("state", event => {
    // Who watches sees the program that runs.
    const isNew = event.activity === "program" && event.program !== running;
    running = event.activity === "program" ? event.program : "";
    if (isNew && running !== job && !uploading && !editing.isOpen() && [...element("jobs").options].some(({value}) => value === running)) {
      element("jobs").value = running;
      open(running);
    }
    if (picture.isPlayed()) return;
    mark(event.program === job ? event.line : 0);
  });
  on("played", ({line}) => mark(line));
  await list();
  // A run that the end of the server has cut off is told at once, and again with the board.
  await showUnfinished();
  let board = "";
  on("state", event => {
    if (event.board && event.board !== board && event.activity === "none") attempt(showUnfinished);
    board = event.board;
  });
}

/** Mark the line that is carried out, or played. */
function mark(line) {
  if (line === now) return;
  now = line;
  if (line) follow(line);
  showText();
}

/** Tell of the last run if the server was killed during it, and offer the line at which it can go on. */
async function showUnfinished() {
  const last = await get("unfinished");
  if (last === null) return;
  if (job !== last.job) {
    element("jobs").value = last.job;
    await open(last.job);
  }
  const where = last.line ? t`at line ${last.line}` : t`before its first line was done`;
  const next = last.line ? t`\u201cFrom line\u201d ${last.line} is filled in to go on there` : t`then run it again`;
  say(t`the server ended during the last run: ${visible(last.job)} was cut off ${where}\nsee where the tool stands, home the machine, and check the zero; ${next}`);
  if (last.line) element("from-line").value = last.line;
  showRun();
}

const path = (rest = "") => `jobs/${encodeURIComponent(job)}${rest}`;

async function list() {
  const jobs = await get("jobs"), select = element("jobs");
  select.replaceChildren(...jobs.map(({name, outcome}) => new Option(outcome ? `${visible(name)} (${word(outcome)})` : visible(name), name)));
  const others = await get("left-out"), most = 5;
  element("left-out").textContent = others.length === 0 ? "" : t`Not in the list: ${others.slice(0, most).map(({name, why}) => `${visible(name)} (${said(why)})`).join("; ")}`
    + (others.length > most ? t`; and ${others.length - most} more files` : "");
  if (!uploading && !jobs.some(({name}) => name === job)) await open(jobs[0]?.name ?? null);
  select.value = job ?? "";
  needs();
}

async function open(name) {
  job = name;
  now = chosen = 0;
  showLength({lines: 0, changed: 0});
  listFindings([]);
  element("limits").hidden = element("stl").hidden = true;
  element("outcome").textContent = "";
  // A line of another job must not be where this one begins.
  element("from-line").value = "";
  isChecked = false;
  delete element("outcome").dataset.refused;
  showRun();
  picture.clear();
  if (job !== null) await attempt(async () => {
    const mine = job, about = await get(path());
    if (mine !== job) return;
    showLength(about);
    if (about.check !== null) await showCheck(about.check);
    else await check();
  });
  element("text").scrollTop = 0;
  showText();
}

/** Show the text of a job as it is now. */
function showLength(about) {
  total = about.lines;
  changed = about.changed;
  windows = new Map();
  element("lines").style.height = `${Math.min(total * ROW, TALLEST)}px`;
  showText();
}

async function upload(event) {
  const file = event.target.files[0];
  event.target.value = "";
  if (!file) return;
  const text = await file.text();
  uploading = true;
  await attempt(async () => {
    await put(`jobs/${encodeURIComponent(file.name)}`, {text});
    await openNew(file.name);
  }).finally(() => { uploading = false; });
}

/** Open a program that was written into the library, and check it. */
export async function openNew(name) {
  uploading = true;
  try {
    await list();
    element("jobs").value = name;
    await open(name);
  } finally {
    uploading = false;
  }
}

/** Return the name of the program that is open, or null. */
export const opened = () => job;

/** Open the program again, as it is now. */
export const reopen = () => open(job);

async function check() {
  if (job === null) return;
  element("outcome").textContent = t`checking`;
  await post(path("/check"), {height_map: heights.chosen()});
}

/** Check the open program now; return whether it is good and its picture shown. */
export async function checkAgain() {
  const mine = job;
  if (mine === null) return false;
  const ended = new Promise(done => { waiting = done; });
  await check();
  const isGood = await ended && job === mine;
  if (!isGood) say(t`${visible(mine)} is refused: the Program part has the findings`);
  return isGood;
}

async function showCheck(given) {
  const mine = job, summary = given ?? await get(path("/check"));
  if (mine !== job) return;
  const errors = summary.errors.filter(({severity}) => severity === "error").length, others = summary.errors.length - errors;
  element("outcome").textContent = summary.ok
    ? t`checked: ${time(summary.duration_s)}, ${summary.path_length_mm.toFixed(1)} mm, ${others} warnings and notes`
    : errors === 1 ? t`refused: 1 error` : t`refused: ${errors} errors`;
  element("outcome").dataset.refused = String(!summary.ok);
  needs();
  listFindings(summary.errors);
  showLimits(summary);
  isChecked = summary.ok;
  if (summary.ok) await picture.show(await get(path("/toolpath")), mine, {seconds: summary.duration_s});
}

/** Show what a simulated cut found, and the part. */
async function showCut({name, ok, findings}) {
  if (!ok) {
    element("outcome").textContent = t`not cut`;
    if (findings.length) listFindings(findings);
    return;
  }
  const part = await get(path("/part"));
  if (name !== job) return;
  element("outcome").textContent = t`cut: ${(part.removed_mm3 / 1000).toPrecision(4)} cm³ removed, cells of ${part.resolution_mm.toPrecision(2)} mm, ${findings.length} findings`;
  element("stl").href = `/api/${path("/stl")}`;
  element("stl").download = name.replace(/\.[^.]*$/, ".stl");
  element("stl").hidden = false;
  listFindings(findings);
  await picture.showPart(part, name);
}

function listFindings(findings) {
  if (editing.isOpen()) return;
  const mine = job, go = line => {
    follow(line);
    if (line !== chosen) choose(line);
  };
  showFindings(findings, mine, go, async line => {
    if (mine !== job) return;
    await open(mine);
    follow(line);
  });
  showText();
}

/** A figure of four digits, without an exponent. */
const figure = value => String(Number(value.toPrecision(4)));

/** Show the largest use of each limit. */
function showLimits({max, limits}) {
  const body = element("limits").tBodies[0], rows = [];
  for (const name of ["feed", "accel", "jerk", "normal_accel"]) if (limits[name] && max[name] !== null) rows.push([word(name.replace("_", " ")), max[name], limits[name]]);
  for (const [axis, values] of Object.entries(max.axes ?? {})) {
    for (const [name, value] of Object.entries(values)) {
      const limit = limits.axes?.[axis]?.[name];
      if (limit && value !== null) rows.push([`${axis.toUpperCase()} ${word(name)}`, value, limit]);
    }
  }
  body.replaceChildren();
  for (const [name, value, limit] of rows.sort((a, b) => b[1] / b[2] - a[1] / a[2]).slice(0, 8)) {
    const row = body.insertRow(), head = document.createElement("th");
    head.scope = "row";
    head.textContent = name;
    row.append(head);
    row.insertCell().textContent = t`${figure(value)} of ${figure(limit)}`;
    // A traverse is limited by the axes, not by the highest feed.
    row.insertCell().textContent = name === word("feed") && value > limit ? t`traverse` : `${Math.round(100 * value / limit)} %`;
  }
  element("limits").hidden = !rows.length;
}

const time = seconds => seconds < 60 ? `${seconds.toFixed(1)} s` : `${Math.floor(seconds / 60)} min ${Math.round(seconds % 60)} s`;

async function run() {
  if (job === null) return;
  const from = Number(element("from-line").value) || null;
  picture.restart();
  say("");
  const begun = await attempt(() => post(path("/run"), {from_line: from, home: element("home-first").checked, trust_position: element("trust").checked, optional_stop: element("optional-stop").checked, height_map: heights.chosen()}));
  if (begun !== null) showPart("run");
}

/** Show what Run would do. */
function showRun() {
  const from = element("from-line").value;
  element("run-what").textContent = job === null ? "" : from ? t`from line ${from}` : visible(job);
  element("empty").hidden = job !== null;
}

function ended({program, outcome, seconds, stopped_at_line: stopped, resume_line: resume, findings}) {
  const errors = findings.filter(({severity}) => severity === "error");
  let text = t`${named(program)}: ${word(outcome)} after ${time(seconds)}`;
  if (stopped) text += t`, stopped at line ${stopped}`;
  if (resume) text += t`; it can go on from line ${resume}`;
  // After a whole run, the next one begins at the first line.
  if (program === job) element("from-line").value = resume ?? "";
  showRun();
  if (program === job) element("outcome").textContent = text;
  const told = errors.map(explained), english = told.map(({detail}) => detail).filter(Boolean).join("\n");
  say([text, ...told.map(({message, hint}) => [message, hint].filter(Boolean).join(english ? " " : "; "))].join("\n"),
    {isNote: outcome === "done", isBrief: outcome === "done" && program === "MDI", english});
}

/** Return px of the whole text for each px of the scroll bar: more than 1 for a text that is taller than an element can be. */
function pace() {
  const view = element("text").clientHeight;
  return Math.max((total * ROW - view) / (Math.min(total * ROW, TALLEST) - view), 1) || 1;
}

/** Show a line of the text in the picture. */
function choose(number) {
  chosen = number === chosen ? 0 : number;
  picture.showLine(chosen);
  showText();
}

/** Scroll to a line. */
function follow(line) {
  const place = element("text"), top = (line - 1) * ROW, above = place.scrollTop * pace();
  if (top < above || top > above + place.clientHeight - 2 * ROW) place.scrollTop = (top - place.clientHeight / 3) / pace();
}

function showText() {
  if (job === null) {
    element("lines").replaceChildren();
    return;
  }
  const place = element("text"), above = place.scrollTop * pace(), first = Math.max(Math.floor(above / ROW) - 5, 0), last = Math.min(first + Math.ceil(place.clientHeight / ROW) + 10, total);
  const rows = [];
  for (let index = first; index < last; index++) {
    const text = line(index), row = document.createElement("li");
    row.style.top = `${place.scrollTop + index * ROW - above}px`;
    writeLine(row, index + 1, text ?? "");
    if (index + 1 === now) {
      row.classList.add("now");
      row.setAttribute("aria-current", "step");
    }
    row.dataset.line = index + 1;
    if (index + 1 === chosen) row.classList.add("chosen");
    rows.push(row);
  }
  element("lines").replaceChildren(...rows);
}

/** Return the text of a line, or null while it is on its way. */
function line(index) {
  const start = Math.floor(index / WINDOW) * WINDOW;
  if (!windows.has(start)) {
    windows.set(start, null);
    const mine = job;
    get(path(`/text?first=${start + 1}&count=${WINDOW}`)).then(({lines}) => {
      if (mine !== job) return;
      windows.set(start, lines);
      showText();
    }).catch(() => windows.delete(start));
  }
  return windows.get(start)?.[index - start] ?? null;
}
