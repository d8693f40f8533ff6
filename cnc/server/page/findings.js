// Findings of a program: their list, their marks in its text, and their repairs.

import {attempt, get, post, visible} from "./api.js";
import {askYes} from "./asking.js";
import {needs, worded} from "./machine.js";
import {detail, explained, said, t, word} from "./texts.js";

const SIGNS = {error: "▲", warning: "!", note: "i"};  // the worst first
const MOST = 200;  // findings of the list
const MOST_LINES = 8;  // changed lines of a question

let marks = new Map();  // the findings of each line of the text

/**
 * Show the findings of a program.
 * `go` is called with line and column of a finding that is pressed, `repaired` with that of a finding that is repaired.
 */
export function showFindings(findings, job, go, repaired) {
  marks = new Map();
  for (const finding of findings) if (finding.line && finding.file === job) marks.set(finding.line, [...marks.get(finding.line) ?? [], finding]);
  document.getElementById("findings").replaceChildren(...findings.slice(0, MOST).map(finding => {
    const {severity, code, file, line, column, fix} = finding, {message, hint, detail: english} = explained(finding), isHere = file === job;
    const item = document.createElement("li"), button = document.createElement("button"), help = document.createElement("small");
    button.type = "button";
    button.className = severity;
    button.textContent = visible(`${file && !isHere ? `${file}, ` : ""}${line ? t`line ${line}: ` : ""}${word(severity)} ${code}: ${message}`);
    button.dataset.sign = SIGNS[severity];
    help.textContent = visible([column ? t`column ${column}` : "", worded(hint)].filter(Boolean).join(": "));
    button.append(help, ...detail(english));
    button.addEventListener("click", () => { if (line && isHere) go(line, column); });
    item.append(button);
    if (fix && isHere) {
      const made = Object.assign(document.createElement("button"), {type: "button", textContent: t`Repair`});
      made.dataset.needs = "link control job";
      made.setAttribute("aria-label", t`Repair line ${line}: ${code}`);
      made.addEventListener("click", () => attempt(() => repair(finding, job, repaired)));
      item.append(made);
    }
    return item;
  }));
  needs();
}

/** Show the lines before and after a repair; write it if the operator agrees. */
async function repair({code, line, column}, job, repaired) {
  const path = `jobs/${encodeURIComponent(job)}/repair`;
  const {title, safe, lines, count, version} = await get(`${path}?${new URLSearchParams({code, line, column})}`);
  const changes = lines.slice(0, MOST_LINES).flatMap(({line: number, old, new: text}) =>
    [`${number} \u2212 ${visible(old)}`, ...text.split("\n").map(each => `${number} + ${visible(each)}`)]);
  if (count > MOST_LINES) changes.push(t`and ${count - MOST_LINES} more lines`);
  const what = t`${visible(job)}, line ${line}: ${visible(said(title))}?\n`;
  const yes = await (safe ? askYes(what + t`The program does the same after it.`, t`Repair`, changes)
    : askYes(what + t`\u26a0 The program may do something else after it. Read the lines first.`, t`Repair, I have read them`, changes));
  if (!yes) return;
  await post(path, {code, line, column, version, unsafe: !safe});
  await repaired(line);
}

/** Return the sign of the worst finding of a line, a blank without one; its row gets the class of it, and the messages. */
export function markSign(row, number) {
  const here = marks.get(number) ?? [], worst = Object.keys(SIGNS).find(each => here.some(({severity}) => severity === each));
  if (worst) {
    row.classList.add(worst);
    row.title = here.map(finding => {
      const {message, detail: english} = explained(finding);
      return [`${finding.code}: ${message}`, ...english.split("\n")].filter(Boolean).map(visible).join("\n");
    }).join("\n");
  }
  return SIGNS[worst] ?? " ";
}

/** Add the text of a line to its row, with a mark at the place of each finding. */
export function writeMarks(row, number, text) {
  const letters = [...number === 1 ? text.replace(/^\ufeff/, "") : text];
  let at = 0;
  for (const {column, severity} of [...marks.get(number) ?? []].sort((a, b) => a.column - b.column)) {
    if (!column || column <= at || column > letters.length + 1) continue;
    const place = document.createElement("mark");
    let end = column;
    while (end < letters.length && /[-+.\d]/.test(letters[end])) end++;
    place.className = severity;
    // What is missing at the end of a line has a blank.
    place.textContent = letters.slice(column - 1, end).join("") || "\u00a0";
    row.append(letters.slice(at, column - 1).join(""), place);
    at = end;
  }
  row.append(letters.slice(at).join(""));
}

/** Write a line of the text into its row, with the sign of its worst finding and a mark at the place of each. */
export function writeLine(row, number, text) {
  row.textContent = `${markSign(row, number)}${String(number).padStart(6)}  `;
  writeMarks(row, number, text);
}
