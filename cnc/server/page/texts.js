// Texts of the page in the language of the operator. The key of a text is the English one; a gettext file has the others.
//
//   t`Undo ${system}`    msgid "Undo {0}"
//   word("running")      a name that the server gives; one that the file does not have stays as it is

import {keep, kept} from "./parts.js";

const LANGUAGES = {en: "English", de: "Deutsch"};
const ATTRIBUTES = ["aria-label", "title", "placeholder"];

let texts = new Map();

/** Return the entries of a gettext file. */
export function entries(file) {
  const found = new Map();
  let key = null, value = null;
  for (const line of file.split("\n")) {
    const [, kind, quoted] = /^(msgid|msgstr)?\s*(".*")$/.exec(line.trim()) ?? [];
    if (quoted === undefined) continue;
    const text = JSON.parse(quoted);
    if (kind === "msgid") [key, value] = [text, null];
    else if (kind === "msgstr") value = text;
    else if (value === null) key += text;
    else value += text;
    if (value !== null && key) found.set(key, value);
  }
  return found;
}

/** Return a text of the page, with the values in their places. */
export function t(parts, ...values) {
  const key = parts.reduce((text, part, k) => `${text}{${k - 1}}${part}`);
  return word(key).replace(/\{(\d+)\}/g, (_, k) => values[k]);
}

/** Return the word for a name of the server. */
export const word = name => texts.get(name) || name;

/** Read the texts of the language, before any other part of the page begins. */
export async function begin() {
  const usual = navigator.language.slice(0, 2), chosen = kept("language");
  const language = [chosen, usual].find(each => each in LANGUAGES) ?? "en", select = document.getElementById("language");
  if (language !== "en") {
    const answer = await fetch(`/page/${language}.po`).catch(() => null);
    if (answer?.ok) texts = entries(await answer.text());
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
