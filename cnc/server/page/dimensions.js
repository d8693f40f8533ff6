// Dimensions of the cuts, drawn over the picture: the sizes of their box, and its places in work coordinates.

import {t} from "./texts.js";

const TICK = 5;       // px
const LEAST = 10;     // px; a shorter side is seen from its end
const FONT = "600 13px system-ui, 'DejaVu Sans', sans-serif";

/** A length without needless zeros, with a true minus sign. */
const figure = value => String(Number(value.toFixed(2))).replace("-", "\u2212");

/**
 * Draw the dimensions of a box.
 * `box` has [low, high] of X, Y and Z in machine coordinates, `project` gives the place of a point on the canvas,
 * `zero` the machine position of the work zero by axis, `paint` the colours.
 */
export function drawDimensions(canvas, box, project, zero, {ink, paper}) {
  const dpr = devicePixelRatio, w = canvas.clientWidth, h = canvas.clientHeight, pen = canvas.getContext("2d");
  if (canvas.width !== Math.round(w * dpr) || canvas.height !== Math.round(h * dpr)) [canvas.width, canvas.height] = [Math.round(w * dpr), Math.round(h * dpr)];
  pen.setTransform(dpr, 0, 0, dpr, 0, 0);
  pen.clearRect(0, 0, w, h);
  if (box === null) return [];
  const [[x0, x1], [y0, y1], [z0, z1]] = box;
  const middle = project((x0 + x1) / 2, (y0 + y1) / 2, (z0 + z1) / 2), texts = [];
  pen.font = FONT;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  for (const [axis, a, b] of [[0, [x0, y0, z0], [x1, y0, z0]], [1, [x1, y0, z0], [x1, y1, z0]], [2, [x1, y1, z0], [x1, y1, z1]]]) {
    const [low, high] = box[axis], name = "XYZ"[axis], from = project(...a), to = project(...b), far = Math.hypot(to[0] - from[0], to[1] - from[1]);
    if (high - low < 5e-4 || far < LEAST) continue;
    // Away from the middle of the box.
    const across = [-(to[1] - from[1]) / far, (to[0] - from[0]) / far], mid = [(from[0] + to[0]) / 2, (from[1] + to[1]) / 2];
    const side = across[0] * (mid[0] - middle[0]) + across[1] * (mid[1] - middle[1]) < 0 ? -1 : 1, off = across.map(each => each * side);
    const shift = (place, by) => [place[0] + off[0] * by, place[1] + off[1] * by];
    const work = zero[name.toLowerCase()], text = `${name} ${figure(high - low)}${work === undefined ? "" : t` (${figure(low - work)} to ${figure(high - work)})`}`;
    pen.strokeStyle = pen.fillStyle = ink;
    pen.lineWidth = 1.2;
    pen.beginPath();
    pen.moveTo(...shift(from, 2 * TICK));
    pen.lineTo(...shift(to, 2 * TICK));
    for (const end of [from, to]) {
      pen.moveTo(...shift(end, TICK));
      pen.lineTo(...shift(end, 3 * TICK));
    }
    pen.stroke();
    const width = pen.measureText(text).width, reach = 3 * TICK + 8 + Math.abs(off[0]) * width / 2;
    const at = shift(mid, reach), x = Math.min(Math.max(at[0], width / 2 + 4), w - width / 2 - 4), y = Math.min(Math.max(at[1], 12), h - 12);
    pen.fillStyle = paper;
    pen.globalAlpha = 0.8;
    pen.fillRect(x - width / 2 - 3, y - 9, width + 6, 18);
    pen.globalAlpha = 1;
    pen.fillStyle = ink;
    pen.fillText(text, x, y);
    texts.push(text);
  }
  return texts;
}
