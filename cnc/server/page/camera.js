// The picture of a camera beside the spindle, with cross hairs and its offset from the tool. The picture stays in the browser.

import {goTo, setZero, turned} from "./hand.js";
import {machine, say, shown, state} from "./machine.js";
import {keep, kept} from "./parts.js";
import {t} from "./texts.js";

const element = id => document.getElementById(id);

let stream = null, mark = null;  // mark: machine position of X and Y at which the tool was on a mark

const offset = () => ({x: element("camera-x").valueAsNumber, y: element("camera-y").valueAsNumber});

export function begin() {
  if (!["x", "y", "z"].every(letter => letter in machine.axes) || machine.kind === "lathe") {
    element("camera-card").remove();
    return;
  }
  const named = `camera-${machine.name}`, before = kept(named);
  if (before) [element("camera-x").value, element("camera-y").value] = [before.x, before.y];
  for (const id of ["camera-x", "camera-y"]) element(id).addEventListener("change", () => { if (isOffset()) keep(named, offset()); });
  element("camera").addEventListener("click", () => stream === null ? start() : end());
  element("camera-device").addEventListener("change", () => { if (stream !== null) start(); });
  element("camera-mark").addEventListener("click", () => {
    mark = {x: state.machine.x, y: state.machine.y};
    element("camera-note").textContent = t`The mark is at machine X ${shown(mark.x)}, Y ${shown(mark.y)}. Raise Z, and jog the cross hairs over it.`;
  });
  element("camera-seen").addEventListener("click", () => {
    if (mark === null) {
      say(t`the place of the mark is not known\nlet the tool touch it, and press the first button`);
      return;
    }
    const found = {x: mark.x - state.machine.x, y: mark.y - state.machine.y};
    [element("camera-x").value, element("camera-y").value] = [found.x.toFixed(3), found.y.toFixed(3)];
    keep(named, offset());
    element("camera-note").textContent = t`The camera is at X ${shown(found.x)}, Y ${shown(found.y)} of the tool.`;
    mark = null;
  });
  // What the cross hairs see becomes the zero: the tool then is at the offset, the other way, turned as the system is.
  element("camera-zero").addEventListener("click", () => {
    if (!isOffset()) return;
    const {x, y} = turned(offset(), -state.rotation);
    setZero({x: -x, y: -y});
  });
  element("camera-go").addEventListener("click", () => {
    if (isOffset()) goTo(state.machine.x + offset().x, state.machine.y + offset().y);
  });
}

/** Return whether the offset is a number; tell it if not. */
function isOffset() {
  const {x, y} = offset(), is = Number.isFinite(x) && Number.isFinite(y);
  if (!is) say(t`the offset of the camera is no number\ngive X and Y in mm`);
  return is;
}

async function start() {
  end();
  if (!navigator.mediaDevices) {
    say(t`a browser shows a camera only to a page of this computer, or over HTTPS\nopen the page as http://127.0.0.1, or behind a proxy with HTTPS`);
    return;
  }
  const chosen = element("camera-device").value;
  try {
    stream = await navigator.mediaDevices.getUserMedia({video: chosen ? {deviceId: {exact: chosen}} : {facingMode: "environment"}});
  } catch (error) {
    say(t`the camera cannot be shown: ${error.message}\nis it connected, free, and allowed for this page?`);
    return;
  }
  element("camera-video").srcObject = stream;
  show();
  // The names are known only after the permission.
  const devices = (await navigator.mediaDevices.enumerateDevices()).filter(({kind}) => kind === "videoinput");
  element("camera-device").replaceChildren(...devices.map(({label, deviceId}, k) => new Option(label || t`camera ${k + 1}`, deviceId)));
  element("camera-device").value = stream?.getVideoTracks()[0].getSettings().deviceId ?? "";
}

function end() {
  for (const track of stream?.getTracks() ?? []) track.stop();
  stream = null;
  show();
}

function show() {
  const isOn = stream !== null;
  element("camera-picture").hidden = !isOn;
  element("camera").setAttribute("aria-pressed", String(isOn));
  element("camera").querySelector("span").textContent = isOn ? t`Camera off` : t`Camera on`;
}
