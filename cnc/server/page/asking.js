// Questions of the page itself: a number, or a yes. A browser's own would stop the signs of life of a jog.

import {t} from "./texts.js";

const element = id => document.getElementById(id);

function ask(text, verb, field, lines = []) {
  const place = element("entry"), value = element("entry-value");
  element("entry-text").textContent = text;
  element("entry-lines").textContent = lines.join("\n");
  element("entry-field").hidden = value.disabled = field === null;
  element("entry-yes").textContent = verb;
  element("entry-unit").textContent = field?.unit ?? "";
  value.value = field?.value ?? "";
  place.returnValue = "";
  place.showModal();
  if (field) value.select();
  return new Promise(answer => place.addEventListener("close", () => answer(place.returnValue === "yes"), {once: true}));
}

/** Ask for a number; return null where none is given. */
export async function askNumber(text, unit) {
  const yes = await ask(text, t`Set`, {value: "0", unit}), value = element("entry-value").valueAsNumber;
  return yes && Number.isFinite(value) ? value : null;
}

/** Return whether the operator agrees; `lines` of a program are shown below the text. */
export const askYes = (text, verb, lines) => ask(text, verb, null, lines);
