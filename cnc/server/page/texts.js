// Texts of the page in the language of the operator. The key of a text is the English one; a gettext file has the others.
//
//   t`Undo ${system}`    msgid "Undo {0}"
//   word("running")      a name that the server gives; one that the file does not have stays as it is
//   said("lift Z to 5")  a sentence of the server: msgctxt "server", msgid "lift Z to {0}"
//   explained(finding)   meaning and remedy of a finding by its code; its English message has the values

import {keep, kept} from "./parts.js";

const LANGUAGES = {en: "English", de: "Deutsch"};
const ATTRIBUTES = ["aria-label", "title", "placeholder"];

const SEPARATORS = [" · ", "; ", ", ", ": "];  // between the sentences and values of a text of the server

let texts = new Map(), sentences = new Map(), patterns = [], meanings = {};

/** Return the entries of a gettext file: those of the page, and those with the context "server". */
function entries(file) {
  const page = new Map(), server = new Map();
  for (const block of file.split("\n\n")) {
    const parts = {msgctxt: "", msgid: "", msgstr: ""};
    let kind = "";
    for (const line of block.split("\n")) {
      const [, begun, quoted] = /^(msgctxt|msgid|msgstr)?\s*(".*")$/.exec(line.trim()) ?? [];
      if (quoted !== undefined) parts[kind = begun ?? kind] += JSON.parse(quoted);
    }
    if (parts.msgid) (parts.msgctxt ? server : page).set(parts.msgid, parts.msgstr);
  }
  return [page, server];
}

/** Return the pattern of a text of the server with values; no value has a separator in it. */
function pattern(text) {
  const letters = text.replace(/[.*+?^$()|[\]\\]/g, "\\$&").replace(/\{\d+\}/g, `((?:(?!${SEPARATORS.join("|")}).)+)`);
  return new RegExp(`^${letters}$`);
}

/** Return a text of the page, with the values in their places. */
export function t(parts, ...values) {
  const key = parts.reduce((text, part, k) => `${text}{${k - 1}}${part}`);
  return word(key).replace(/\{(\d+)\}/g, (_, k) => values[k]);
}

/** Return the word for a name of the server. */
export const word = name => texts.get(name) || name;

/** Return a text of the server: each line as a whole, or in its parts; a part that the file does not have stays English. */
export const said = text => text.split("\n").map(sentence).join("\n");

function sentence(text) {
  const whole = sentences.get(text) ?? texts.get(text);
  if (whole) return whole;
  for (const [each, other] of patterns) {
    const values = each.exec(text);
    if (values) return other.replace(/\{(\d+)\}/g, (_, k) => sentence(values[Number(k) + 1]));
  }
  const separator = SEPARATORS.find(each => text.includes(each));
  return separator ? text.split(separator).map(sentence).join(separator) : text;
}

/** Return `message`, `hint` and `detail` of a finding; the detail is what the server says, where that is another language. */
export function explained({code, message, hint}) {
  const mine = meanings[code];
  if (!mine) return {message, hint: hint ?? "", detail: ""};
  const plain = text => text.replaceAll("`", "");
  return {message: plain(mine.meaning), hint: plain(mine.remedy), detail: hint ? `${message}\nhelp: ${hint}` : message};
}

/** Return an element with the English text of the server, none for "". */
export const detail = text => text ? [Object.assign(document.createElement("small"), {className: "detail", lang: "en", textContent: text})] : [];

/** Read the texts of the language, before any other part of the page begins. */
export async function begin() {
  const usual = navigator.language.slice(0, 2), chosen = kept("language");
  const language = [chosen, usual].find(each => each in LANGUAGES) ?? "en", select = document.getElementById("language");
  if (language !== "en") {
    const [page, findings] = await Promise.all([`/page/${language}.po`, `/api/meanings/${language}`].map(each => fetch(each).catch(() => null)));
    if (page?.ok) {
      [texts, sentences] = entries(await page.text());
      if (findings?.ok) meanings = await findings.json();
    }
    const length = text => text.replace(/\{\d+\}/g, "").length;
    patterns = [...sentences].sort(([one], [other]) => length(other) - length(one)).map(([text, other]) => [pattern(text), other]);
  }
  if (texts.size) document.documentElement.lang = language;
  translate(document.body);
  select.replaceChildren(...Object.entries(LANGUAGES).map(([code, name]) => new Option(name, code)));
  select.value = language;
  select.addEventListener("change", () => {
    keep("language", select.value);
    location.reload();
  });
}

/** Put the texts of the language into the page. */
function translate(root) {
  const walker = document.createTreeWalker(root, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const [, before, text, after] = /^(\s*)(.*?)(\s*)$/s.exec(walker.currentNode.data), other = texts.get(text);
    if (other) walker.currentNode.data = before + other + after;
  }
  for (const name of ATTRIBUTES) for (const place of root.querySelectorAll(`[${name}]`)) {
    place.setAttribute(name, word(place.getAttribute(name)));
  }
}
