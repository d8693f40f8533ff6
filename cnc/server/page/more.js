// MDI, console, probing, macros, settings of the board, history.

import {attempt, get, on, post, put, visible} from "./api.js";
import {needs, say} from "./machine.js";

const element = id => document.getElementById(id);
const KEPT = 2000;  // lines of the console

const kept = [];
let due = false;

export function begin() {
  element("mdi-form").addEventListener("submit", async event => {
    event.preventDefault();
    const line = element("mdi").value.trim();
    if (!line) return;
    if (await attempt(() => post("mdi", {line})) !== null) {
      element("mdi").value = "";
      showEntered();
    }
  });
  on("console", event => {
    kept.push(event);
    if (kept.length > KEPT) kept.splice(0, kept.length - KEPT);
    showConsole();
  });
  for (const id of ["filter", "show-status"]) element(id).addEventListener("input", showConsole);
  element("settings-part").addEventListener("toggle", showSettings);
  element("history-part").addEventListener("toggle", showHistory);
  on("job-ended", () => { if (element("history-part").open) showHistory(); });
  attempt(async () => {
    showCycles(await get("probing"));
    showMacros(await get("macros"));
    await showEntered();
    needs();
  });
}

async function showEntered() {
  const lines = await get("mdi");
  element("mdi-history").replaceChildren(...[...new Set(lines)].reverse().slice(0, 30).map(each => new Option(each)));
}

function showConsole() {
  if (due) return;
  due = true;
  requestAnimationFrame(() => {
    due = false;
    const place = element("console"), wanted = element("filter").value.toLowerCase(), withStatus = element("show-status").checked;
    const atEnd = place.scrollTop + place.clientHeight > place.scrollHeight - 30;
    const shown = kept.filter(({text}) => (withStatus || !/^(<|\?)/.test(text)) && text.toLowerCase().includes(wanted));
    place.textContent = shown.slice(-400).map(({direction, text}) => (direction === "sent" ? "> " : "  ") + text).join("\n");
    if (atEnd) place.scrollTop = place.scrollHeight;
  });
}

function showCycles(cycles) {
  for (const cycle of cycles) {
    const form = document.createElement("form"), title = document.createElement("h3"), run = document.createElement("button");
    title.textContent = cycle.title;
    form.append(title);
    for (const {name, title: label, default: value} of cycle.parameters) {
      const field = document.createElement("label"), input = Object.assign(document.createElement("input"), {type: "number", step: "any", name, value});
      field.append(`${label} `, input);
      form.append(field);
    }
    run.type = "submit";
    run.dataset.needs = "link control board free unlocked";
    run.textContent = `Run ${cycle.name}`;
    form.append(run);
    form.addEventListener("submit", event => {
      event.preventDefault();
      const parameters = Object.fromEntries([...new FormData(form)].map(([name, value]) => [name, Number(value)]));
      attempt(() => post(`probing/${encodeURIComponent(cycle.name)}/run`, {parameters}));
    });
    element("cycles").append(form);
  }
}

function showMacros(names) {
  element("macros").replaceChildren(...names.map(name => {
    const made = Object.assign(document.createElement("button"), {type: "button", textContent: name});
    made.dataset.needs = "link control board idle";
    made.addEventListener("click", () => attempt(() => post(`macros/${encodeURIComponent(name)}/run`)));
    return made;
  }));
  if (!names.length) element("macros").textContent = "The folder of macros is empty.";
}

async function showSettings() {
  if (!element("settings-part").open) return;
  const settings = await attempt(() => get("settings"));
  if (settings === null) return;
  const body = element("settings").tBodies[0];
  body.replaceChildren();
  for (const {number, value, name, unit, machine_file: wanted} of settings) {
    const row = body.insertRow(), field = Object.assign(document.createElement("input"), {value, size: 9});
    const implied = document.createElement("td"), written = document.createElement("td");
    written.setAttribute("role", "status");
    field.setAttribute("aria-label", `$${number} ${name}`);
    field.addEventListener("change", async () => {
      written.textContent = "";
      if (!/^-?\d{1,10}(\.\d{1,6})?$/.test(field.value.trim())) {
        say(`${field.value} is no value of a setting\ngive a number, such as 250 or 0.010`);
        return;
      }
      const done = await attempt(() => put(`settings/${number}`, {value: field.value.trim()}));
      // The server has read the setting back from the board; it is shown as the board has it.
      const now = await attempt(() => get("settings")), mine = now?.find(each => each.number === number);
      if (!mine) return;
      field.value = mine.value;
      implied.textContent = mine.machine_file ?? "";
      written.textContent = done === null ? "refused" : "verified";
    });
    row.insertCell().textContent = `$${number}`;
    row.insertCell().textContent = name;
    row.insertCell().append(field);
    row.insertCell().textContent = unit;
    implied.textContent = wanted ?? "";
    row.append(implied, written);
  }
}

async function showHistory() {
  if (!element("history-part").open) return;
  const runs = await attempt(() => get("history"));
  if (runs === null) return;
  const body = element("history").tBodies[0], logged = new Set();
  body.replaceChildren();
  for (const {job, began, outcome, seconds, findings} of runs) {
    const row = body.insertRow(), when = typeof began === "number" ? new Date(began * 1000) : new Date(began);
    for (const text of [when.toLocaleString(), visible(job), outcome, `${seconds.toFixed(1)} s`]) row.insertCell().textContent = text;
    row.cells[2].title = (findings ?? []).map(({message}) => message).join("\n");
    const cell = row.insertCell();
    // The library keeps the log of the last run of each job.
    if (logged.has(job)) continue;
    logged.add(job);
    const made = Object.assign(document.createElement("button"), {type: "button", textContent: "Log"});
    made.setAttribute("aria-label", `Log of ${job}`);
    made.addEventListener("click", () => attempt(async () => {
      const {text} = await get(`jobs/${encodeURIComponent(job)}/log`);
      element("log").hidden = false;
      element("log").textContent = text;
      element("log").focus();
    }));
    cell.append(made);
  }
}
