// Parts of the page, and what this browser keeps: theme, glove mode, the height for moves by hand, named positions.

const element = id => document.getElementById(id);
const listeners = [];
let part = "run";

/** Call a listener with the name of each part that is opened. */
export const onPart = listener => listeners.push(listener);

/** Return the name of the part that is open. */
export const openPart = () => part;

/** Open a part of the page. */
export function showPart(name) {
  part = name;
  document.querySelector("main").dataset.part = element("stage").dataset.part = name;
  for (const button of document.querySelectorAll("nav button")) button.setAttribute("aria-pressed", String(button.dataset.part === name));
  for (const place of document.querySelectorAll("[data-in]")) place.hidden = !place.dataset.in.split(" ").includes(name);
  element("stage").scrollTop = document.querySelector("main").scrollTop = 0;
  for (const listener of listeners) listener(name);
}

/** Return a picture of the icons of the page. */
export function icon(name) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", "svg"), use = document.createElementNS("http://www.w3.org/2000/svg", "use");
  made.setAttribute("class", "icon");
  made.setAttribute("aria-hidden", "true");
  use.setAttribute("href", `/page/icons.svg#${name}`);
  made.append(use);
  return made;
}

/** Return what this browser keeps under a name, or null. A browser may refuse to keep anything. */
export function kept(name) {
  try {
    return JSON.parse(localStorage.getItem(`cncrun-${name}`));
  } catch {
    return null;
  }
}

/** Keep a value in this browser. */
export function keep(name, value) {
  try {
    localStorage.setItem(`cncrun-${name}`, JSON.stringify(value));
  } catch { /* It holds until the page is closed. */ }
}

/** Begin with the kept theme and size; `changed` is called after a change of either. */
export function begin(changed) {
  const root = document.documentElement, dark = matchMedia("(prefers-color-scheme: dark)"), usual = () => dark.matches ? "dark" : "light";
  const theme = name => {
    root.dataset.theme = name;
    element("theme").querySelector("use").setAttribute("href", `/page/icons.svg#${name === "dark" ? "sun" : "moon"}`);
    changed();
  };
  const glove = on => {
    root.dataset.size = on ? "glove" : "usual";
    element("glove").checked = on;
    changed();
  };
  theme(kept("theme") ?? usual());
  glove(kept("glove") === true);
  dark.addEventListener("change", () => theme(kept("theme") ?? usual()));
  element("theme").addEventListener("click", () => {
    theme(root.dataset.theme === "dark" ? "light" : "dark");
    keep("theme", root.dataset.theme);
  });
  element("glove").addEventListener("change", () => {
    glove(element("glove").checked);
    keep("glove", element("glove").checked);
  });
  for (const button of document.querySelectorAll("nav button")) button.addEventListener("click", () => showPart(button.dataset.part));
  element("to-program").addEventListener("click", () => showPart("program"));
  showPart("run");
}
