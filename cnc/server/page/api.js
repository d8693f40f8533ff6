// Requests to the server, the control of the machine, and the stream of events.

import {t} from "./texts.js";

let key = null, name = "";
const listeners = new Map();

/** Call `listener` with each event of a kind. */
export function on(kind, listener) {
  if (!listeners.has(kind)) listeners.set(kind, []);
  listeners.get(kind).push(listener);
}

/** Pass an event on to its listeners. */
export function emit(event) {
  for (const listener of listeners.get(event.event) ?? []) listener(event);
}

/** Return a name with visible escapes in place of letters that change the order of others, or show nothing. */
export const visible = text => text.replace(/[\p{Cc}\p{Cf}\p{Co}\p{Cn}]/gu,
  letter => letter === "\u200d" ? letter : `\\u{${letter.codePointAt(0).toString(16)}}`);

/** A refused request: a finding of the server. */
export class Refused extends Error {
  constructor(finding) {
    super([finding.message, finding.hint].filter(Boolean).join("\n"));
    this.finding = finding;
  }
}

/** Send a request and return the answer. */
export async function send(method, path, body) {
  const headers = {};
  if (body !== undefined) headers["Content-Type"] = "application/json";
  if (key !== null) headers["X-Control"] = key;
  let answer;
  try {
    answer = await fetch("/api/" + path, {method, headers, body: body === undefined ? undefined : JSON.stringify(body)});
  } catch {
    throw new Refused({code: "server-lost", message: t`the server does not answer`, hint: t`check that cncrun serve is running`});
  }
  const found = await answer.json().catch(() => ({}));
  if (answer.ok) return found;
  if (found.code === "no-control") {
    found.hint = t`press Take control first`;
    if (key !== null) loseControl();
  }
  throw new Refused(found.message ? found : {code: "", message: t`the server refuses this (${answer.status})`});
}

export const get = path => send("GET", path);
export const post = (path, body = {}) => send("POST", path, body);
export const put = (path, body) => send("PUT", path, body);
export const remove = path => send("DELETE", path);

/** Carry out a command and show what goes wrong. */
export async function attempt(action) {
  try {
    return await action();
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    emit({event: "alarm", finding: error.finding, refused: true});
    return null;
  }
}

export const inControl = () => key !== null;

/** Take control of the machine under the name of this client. */
export async function takeControl() {
  name = (matchMedia("(pointer: coarse)").matches ? "phone " : "browser ") + Math.floor(Math.random() * 900 + 100);
  const granted = await post("control", {client: name});
  key = granted.key;
  tell({control: key});
  emit({event: "control", holder: granted.holder});
}

export async function giveControl() {
  await remove("control");
  loseControl();
}

function loseControl() {
  key = null;
  emit({event: "control", holder: null});
}

let socket = null;

/** Send a short message at once: the sign of life of a jog, or a stop. */
export function tell(message) {
  if (socket?.readyState === WebSocket.OPEN) socket.send(JSON.stringify(message));
}

/** Keep the stream of events open. */
export function listen() {
  socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/events`);
  socket.onopen = () => {
    if (key !== null) tell({control: key});
    emit({event: "link", open: true});
  };
  socket.onmessage = ({data}) => {
    for (const event of JSON.parse(data)) {
      if (event.event === "control" && key !== null && event.holder !== name) key = null;
      emit(event);
    }
  };
  socket.onclose = () => {
    emit({event: "link", open: false});
    setTimeout(listen, 1000);
  };
}
