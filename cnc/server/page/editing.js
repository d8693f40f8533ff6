// Text of a program or a macro that is changed in the page, with its findings as it is typed.
//
//   #edit-signs   #edit-place
//   ! 12          textarea above #edit-marks: the marks have no letters to be seen, only their wavy lines

import {Refused, attempt, get, post, put, remove, visible} from "./api.js";
import {askYes} from "./asking.js";
import {markSign, showFindings, writeMarks} from "./findings.js";
import * as jobs from "./jobs.js";
import {needs, say} from "./machine.js";
import {showPart} from "./parts.js";
import {explained, t} from "./texts.js";

const element = id => document.getElementById(id);
const ROW = 19;        // px, height of a line
const MOST = 500_000;  // characters; the server reads no longer text as it is typed
const PAUSE = 300;     // ms without a key, after which the text is read
const FRESH = "G21 G90 G94\n\nM2\n";

let open = null;       // {kind: "job" | "macro", name, saved, changed}, of the text that is changed
let isSaving = false;  // until the saved program is the one that Run runs
let timer = 0, reading = false, again = false;

/** Return whether a text is being changed. */
export const isOpen = () => open !== null;

export function begin() {
  const area = element("editor");
  element("edit").addEventListener("click", () => attempt(editJob));
  element("new").addEventListener("click", () => edit({kind: "job", name: "new.nc", saved: null, changed: null}, FRESH));
  element("new-macro").addEventListener("click", () => edit({kind: "macro", name: "new.ngc", saved: null, changed: null}, FRESH));
  element("edit-save").addEventListener("click", () => attempt(save));
  element("edit-close").addEventListener("click", () => leave().then(yes => { if (yes) close(); }));
  element("edit-remove").addEventListener("click", () => attempt(removeMacro));
  area.addEventListener("input", () => {
    showChanged();
    draw();
    readSoon();
  });
  element("edit-name").addEventListener("input", readSoon);
  area.addEventListener("scroll", draw);
  new ResizeObserver(draw).observe(area);
  addEventListener("beforeunload", event => { if (isChanged()) event.preventDefault(); });
}

async function editJob() {
  const name = jobs.opened(), about = await get(`jobs/${encodeURIComponent(name)}`);
  if (about.size > MOST) {
    say(t`${visible(name)} is longer than ${MOST} characters\nchange it in an editor, and upload it`);
    return;
  }
  const lines = [];
  while (lines.length < about.lines) lines.push(...(await get(`jobs/${encodeURIComponent(name)}/text?first=${lines.length + 1}&count=5000`)).lines);
  edit({kind: "job", name, changed: about.changed}, [...lines, ""].join("\n"));
}

/** Change a macro. */
export async function editMacro(name) {
  const {text} = await get(`macros/${encodeURIComponent(name)}`);
  edit({kind: "macro", name, changed: null}, text);
}

/** Open a text. `saved: null` is one that no file has. */
async function edit(what, text) {
  if (!await leave()) return;
  open = {saved: text, ...what};
  element("editor").value = text;
  element("edit-name").value = what.name;
  element("edit-remove").hidden = what.kind !== "macro" || open.saved === null;
  element("edit-box").hidden = false;
  element("outcome").textContent = "";
  showChanged();
  element("stage").dataset.editing = "true";
  showPart("program");
  element("editor").scrollTop = element("editor").scrollLeft = 0;
  element("editor").setSelectionRange(0, 0);
  element("editor").focus();
  list([]);
  read();
}

/** What is not saved must not be taken for what Run would run. */
function showChanged() {
  element("edit-box").dataset.changed = String(isChanged());
  needs();
}

const isChanged = () => isSaving || (open !== null && element("editor").value !== open.saved);

/** Return whether the text may be left: it is saved, or the operator agrees to lose it. */
export async function leave() {
  return !isChanged() || askYes(t`The changes of ${visible(element("edit-name").value)} are not saved. Lose them?`, t`Lose them`);
}

function close({isOther = false} = {}) {
  const wasJob = open?.kind === "job";
  open = null;
  showChanged();
  clearTimeout(timer);
  element("edit-box").hidden = true;
  delete element("stage").dataset.editing;
  if (!isOther) attempt(() => jobs.reopen());
  showPart(wasJob ? "program" : "setup");
}

async function save() {
  const {kind, name: before, changed, saved} = open, name = element("edit-name").value.trim(), text = element("editor").value;
  const path = `${kind}s/${encodeURIComponent(name)}`, isNew = saved === null || name !== before;
  if (isNew && (await get(`${kind}s`)).some(each => (each.name ?? each) === name) && !await askYes(t`Replace ${visible(name)}?`, t`Replace`)) return;
  const time = kind === "job" && !isNew ? `?changed=${changed}` : "";
  isSaving = true;
  try {
    await put(path + time, {text});
    open.saved = text;
    if (kind === "job") await jobs.openNew(name);
    close({isOther: kind === "job"});
  } finally {
    isSaving = false;
    showChanged();
  }
}

async function removeMacro() {
  const {name} = open;
  if (!await askYes(t`Remove the macro ${visible(name)}?`, t`Remove`)) return;
  await remove(`macros/${encodeURIComponent(name)}`);
  open.saved = element("editor").value;
  close();
}

function readSoon() {
  clearTimeout(timer);
  timer = setTimeout(read, PAUSE);
}

/** Read the text as it is now; while one is read, the next waits. */
async function read() {
  if (open === null) return;
  if (reading) {
    again = true;
    return;
  }
  reading = true;
  const mine = open, name = element("edit-name").value.trim(), text = element("editor").value;
  try {
    const found = text.length > MOST ? null : await post(`findings/${encodeURIComponent(name)}`, {text});
    if (open === mine && found === null) element("edit-state").textContent = t`longer than ${MOST} characters: not read`;
    else if (open === mine && element("editor").value === text) list(found);
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    if (open === mine) element("edit-state").textContent = visible(explained(error.finding).message);
  } finally {
    reading = false;
  }
  if (again) {
    again = false;
    read();
  }
}

/** Show the findings of the text. A repair needs a saved file. */
function list(findings) {
  const errors = findings.filter(({severity}) => severity === "error").length;
  const [first] = findings.filter(({severity}) => severity === "error" || !errors);
  element("edit-state").textContent = (errors === 1 ? t`1 error, ${findings.length - errors} warnings and notes` : t`${errors} errors, ${findings.length - errors} warnings and notes`)
    + (first ? t`; line ${first.line}: ${visible(explained(first).message)}` : "");
  showFindings(findings.map(finding => ({...finding, fix: null})), element("edit-name").value.trim(), goTo);
  draw();
}

/** Put the caret at a place of the text. */
function goTo(line, column = 1) {
  const area = element("editor"), lines = area.value.split("\n");
  const at = lines.slice(0, line - 1).reduce((sum, each) => sum + each.length + 1, 0) + [...lines[line - 1] ?? ""].slice(0, Math.max(column - 1, 0)).join("").length;
  area.focus();
  area.setSelectionRange(at, at);
  area.scrollTop = Math.max((line - 1) * ROW - area.clientHeight / 3, 0);
}

/** Draw the numbers, signs and marks of the lines that are in sight. */
function draw() {
  if (open === null) return;
  const area = element("editor"), lines = area.value.split("\n"), first = Math.max(Math.floor(area.scrollTop / ROW) - 2, 0);
  const last = Math.min(first + Math.ceil(area.clientHeight / ROW) + 4, lines.length), signs = [], marks = [];
  for (let index = first; index < last; index++) {
    const sign = document.createElement("div"), mark = document.createElement("div");
    sign.style.top = mark.style.top = `${index * ROW - area.scrollTop}px`;
    mark.style.left = `${-area.scrollLeft}px`;
    sign.textContent = `${markSign(sign, index + 1)}${String(index + 1).padStart(6)}`;
    writeMarks(mark, index + 1, lines[index]);
    signs.push(sign);
    marks.push(mark);
  }
  element("edit-signs").replaceChildren(...signs);
  element("edit-marks").replaceChildren(...marks);
}
