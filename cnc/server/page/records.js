// Records: the lines of the board, the runs with their logs, the settings of the board.

import {attempt, get, on, put, visible} from "./api.js";
import {say, state} from "./machine.js";
import {onPart, openPart} from "./parts.js";
import {explained, said, t, word} from "./texts.js";

const element = id => document.getElementById(id);
const KEPT = 2000;  // lines of the console

const lines = [];
let due = false;

export function begin() {
  on("console", event => {
    lines.push(event);
    if (lines.length > KEPT) lines.splice(0, lines.length - KEPT);
    showConsole();
  });
  for (const id of ["filter", "show-status"]) element(id).addEventListener("input", showConsole);
  element("read-settings").addEventListener("click", showSettings);
  onPart(name => {
    if (name === "history") showHistory();
    if (name === "setup") showConsole();
    if (name === "settings" && state.board && state.activity === "none") showSettings();
  });
  on("job-ended", () => { if (openPart() === "history") showHistory(); });
}

function showConsole() {
  if (due || openPart() !== "setup") return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    const place = element("console"), wanted = element("filter").value.toLowerCase(), withStatus = element("show-status").checked;
    const atEnd = place.scrollTop + place.clientHeight > place.scrollHeight - 30;
    const shown = lines.filter(({text}) => (withStatus || !/^(<|\?)/.test(text)) && text.toLowerCase().includes(wanted));
    place.textContent = shown.slice(-400).map(({direction, text}) => (direction === "sent" ? "> " : "  ") + text).join("\n");
    if (atEnd) place.scrollTop = place.scrollHeight;
  });
}

async function showSettings() {
  const settings = await attempt(() => get("settings"));
  if (settings === null) return;
  const body = element("settings").tBodies[0];
  body.replaceChildren();
  for (const {number, value, name, unit, machine_file: wanted} of settings) {
    const row = body.insertRow(), field = Object.assign(document.createElement("input"), {value, size: 9});
    const implied = document.createElement("td"), written = document.createElement("td");
    written.setAttribute("role", "status");
    field.setAttribute("aria-label", `$${number} ${said(name)}`);
    field.addEventListener("change", async () => {
      written.textContent = "";
      if (!/^-?\d{1,10}(\.\d{1,6})?$/.test(field.value.trim())) {
        say(t`${field.value} is no value of a setting\ngive a number, such as 250 or 0.010`);
        return;
      }
      const done = await attempt(() => put(`settings/${number}`, {value: field.value.trim()}));
      // The server has read the setting back from the board; it is shown as the board has it.
      const now = await attempt(() => get("settings")), mine = now?.find(each => each.number === number);
      if (!mine) return;
      field.value = mine.value;
      implied.textContent = mine.machine_file ?? "";
      written.textContent = done === null ? t`refused` : t`verified`;
    });
    row.insertCell().textContent = `$${number}`;
    row.insertCell().append(said(name), Object.assign(document.createElement("span"), {className: "small", textContent: ` ${said(unit)}`}));
    row.insertCell().append(field);
    implied.textContent = wanted ?? "";
    row.append(implied, written);
  }
}

async function showHistory() {
  const runs = await attempt(() => get("history"));
  if (runs === null) return;
  const body = element("history").tBodies[0];
  body.replaceChildren();
  for (const {job, began, outcome, seconds, findings} of runs) {
    const row = body.insertRow(), when = typeof began === "number" ? new Date(began * 1000) : new Date(began);
    for (const text of [when.toLocaleString(), visible(job), word(outcome), `${seconds.toFixed(1)} s`]) row.insertCell().textContent = text;
    row.cells[2].title = (findings ?? []).map(finding => explained(finding).message).join("\n");
    const cell = row.insertCell();
    const made = Object.assign(document.createElement("button"), {type: "button", textContent: t`Log`});
    made.setAttribute("aria-label", t`Log of ${visible(job)}, ${when.toLocaleString()}`);
    made.addEventListener("click", () => attempt(async () => {
      const {text} = await get(`jobs/${encodeURIComponent(job)}/log?began=${began}`);
      element("log").hidden = false;
      element("log").textContent = text || t`This log is no longer kept.`;
      element("log").focus();
    }));
    cell.append(made);
  }
}
