// Starts the parts of the page.

import {attempt, listen} from "./api.js";
import * as heights from "./heights.js";
import * as jobs from "./jobs.js";
import * as machine from "./machine.js";
import * as more from "./more.js";
import * as picture from "./picture.js";

const root = document.documentElement, dark = matchMedia("(prefers-color-scheme: dark)");

function theme(name) {
  root.dataset.theme = name;
  picture.redraw();
}

theme(dark.matches ? "dark" : "light");
dark.addEventListener("change", () => theme(dark.matches ? "dark" : "light"));
document.getElementById("theme").addEventListener("click", () => theme(root.dataset.theme === "dark" ? "light" : "dark"));
for (const button of document.querySelectorAll("nav button")) button.addEventListener("click", () => {
  document.querySelector("main").dataset.part = button.dataset.part;
  for (const each of document.querySelectorAll("nav button")) each.setAttribute("aria-pressed", String(each === button));
  picture.redraw();
});

await attempt(async () => {
  await machine.begin();
  await heights.begin();
  await jobs.begin();
  picture.begin();
  more.begin();
  listen();
});
