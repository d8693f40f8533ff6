// What each control of the page needs. One that cannot work now is marked, and says why when it is pressed.
//
//   <button data-needs="control board idle">   the first need that is not met is the reason

import {t, word} from "./texts.js";

const element = id => document.getElementById(id);
const PAUSES = ["tool", "stop"];
const MOVING = ["running", "jogging", "homing"];

/** Return whether a program waits at M0 or M6, where the machine may be used by hand. */
export const isPaused = () => element("question").open && PAUSES.includes(element("question").dataset.kind);
const busy = ({activity}) => activity === "measure" ? t`a measurement is under way: answer its questions, or press STOP` : t`the machine is busy (${word(activity)}): wait for its end, or press STOP`;

/** By name: whether the need is met, and the reason where it is not. */
const NEEDS = {
  link: [({isOpen}) => isOpen, () => t`the server does not answer: wait for the connection, or use the emergency stop`],
  control: [({mine}) => mine, () => t`you watch: press Take control first`],
  offered: [({mine, holder}) => mine || holder === null, () => NEEDS.control[1]()],
  board: [({state}) => state.state !== "disconnected", () => t`no board is connected: connect it first`],
  idle: [({state}) => state.activity === "none", ({state}) => busy(state)],
  free: [({state}) => ["none", "jog"].includes(state.activity) || isPaused(), ({state}) => busy(state)],
  undo: [() => element("undo-zero").dataset.count !== "0", () => t`no zero was set here that could be undone`],
  homed: [({state}) => element("unhomed").checked || Object.values(state.homed).every(Boolean),
    () => t`the machine is not homed: press Home, or tick \u201cwithout homing\u201d`],
  placed: [({state}) => Object.values(state.homed).every(Boolean), () => t`the machine is not homed: press Home first`],
  unlocked: [({state}) => state.state !== "alarm", () => t`the board is locked: home it, or press Unlock`],
  motion: [({state}) => MOVING.includes(state.state), () => t`nothing moves that could be held`],
  held: [({state}) => state.held !== "" || ["held", "door"].includes(state.state), () => t`nothing is held`],
  saved: [() => element("edit-box").dataset.changed !== "true", () => t`the text in the editor is not saved: save or close it first`],
  job: [() => element("jobs").value !== "", () => t`the library is empty: upload a program first`],
};

/** Mark each control that cannot work now. */
export function showNeeds(situation) {
  for (const place of document.querySelectorAll("[data-needs]")) {
    const missing = place.dataset.needs.split(" ").find(name => !NEEDS[name][0](situation));
    const why = missing ? NEEDS[missing][1](situation) : "";
    if ((place.dataset.why ?? "") === why) continue;
    place.dataset.why = why;
    place.title = why || (place.getAttribute("aria-label") ?? "");
    if (why) place.setAttribute("aria-disabled", "true");
    else place.removeAttribute("aria-disabled");
  }
}

/** Let a marked control say why it does not work, in place of its action. */
export function explain(say) {
  const stopped = event => {
    const place = event.target.closest?.("[aria-disabled=true]");
    if (!place || event.type === "keydown" && event.key !== "Enter" && event.key !== " ") return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.type !== "pointerdown") say(place.dataset.why);
  };
  for (const kind of ["pointerdown", "click", "keydown", "submit"]) document.addEventListener(kind, stopped, true);
}
