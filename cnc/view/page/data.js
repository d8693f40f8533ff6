// Data of the page: columns of numbers and the bytes of the programs, deflated and in base 64. None of it ever
// becomes markup.

/** Where the data stands: in elements of the page, each removed when it is taken. */
let packages = {
  has: id => document.getElementById(id) !== null,
  take: id => {
    const element = document.getElementById(id), text = element.textContent;
    element.remove();
    return text;
  },
};

/** Return the bytes of a package. */
async function packed(id) {
  const text = packages.take(id);
  let bytes;
  if (Uint8Array.fromBase64) bytes = Uint8Array.fromBase64(text);
  else {
    const letters = atob(text);
    bytes = new Uint8Array(letters.length);
    for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  }
  const stream = new DecompressionStream("deflate"), writer = stream.writable.getWriter();
  const written = writer.write(bytes).then(() => writer.close()), out = await new Response(stream.readable).arrayBuffer();
  await written;
  return new Uint8Array(out);
}

/** Return whole numbers from their differences: sign in the lowest bit, the lowest bytes of all numbers first. */
async function integers(name) {
  const bytes = await packed("column-" + name), n = bytes.length / 4, out = new Int32Array(n);
  for (let i = 0, value = 0; i < n; i++) {
    const z = bytes[i] | bytes[n + i] << 8 | bytes[2 * n + i] << 16 | bytes[3 * n + i] << 24;
    out[i] = value = value + (z >>> 1 ^ -(z & 1)) | 0;
  }
  return out;
}

/** Return floats of 32 bits; the lowest bytes of all numbers come first. */
async function floats(name) {
  const bytes = await packed("column-" + name), n = bytes.length / 4, out = new Uint8Array(bytes.length);
  for (let i = 0; i < n; i++) for (let k = 0; k < 4; k++) out[4 * i + k] = bytes[k * n + i];
  return new Float32Array(out.buffer);
}

/** Return times in seconds. */
async function times(name, tick) {
  const ticks = await integers(name), out = new Float64Array(ticks.length);
  for (let i = 0; i < ticks.length; i++) out[i] = (ticks[i] >>> 0) * tick;
  return out;
}

/** Return numbers that were scaled to whole numbers. */
async function scaled(name, unit) {
  const whole = await integers(name), out = new Float32Array(whole.length);
  for (let i = 0; i < whole.length; i++) out[i] = whole[i] * unit;
  return out;
}

/** Return all data: `about` (read from its package unless it is given), the strokes of the path, the curves, those of the joints, the source lines over time, the program texts. */
async function load(given = null) {
  const about = given ?? JSON.parse(new TextDecoder().decode(await packed("about")));
  const {tick, quantum, units} = about;
  const t = await times("t", tick), n = t.length;
  const at = [];
  for (const axis of "xyz") at.push(await integers(axis));
  const place = new Float32Array(3 * n);
  for (let k = 0; k < 3; k++) for (let i = 0; i < n; i++) place[3 * i + k] = at[k][i] * quantum;
  const strokes = {
    n, t, place, origin: about.middle,
    channels: [await scaled("feed", units.feed), await scaled("accel", units.accel), await scaled("jerk", units.jerk)],
    rapid: await integers("rapid"),
  };
  const curves = {t: await times("curve-t", tick), exact: about.exact, start: [], low: [], high: []};
  for (const name of ["feed", "accel", "jerk"]) {
    if (curves.exact) curves.start.push(await floats("start-" + name));
    else {
      curves.low.push(await floats("low-" + name));
      curves.high.push(await floats("high-" + name));
    }
  }
  const joints = [];
  if (about.joints?.length) {
    const t = await times("joint-t", tick);
    for (const [k, joint] of about.joints.entries()) {
      const low = [], high = [];
      for (const name of ["position", "velocity", "acceleration"]) {
        low.push(await floats(`joint-${k}-low-${name}`));
        high.push(await floats(`joint-${k}-high-${name}`));
      }
      joints.push({...joint, t, exact: false, low, high});
    }
  }
  const origins = {t: await times("origin-t", tick), first: await integers("origin-first")};
  for (const name of ["more", "file"]) {
    origins[name] = packages.has("column-origin-" + name) ? await integers("origin-" + name) : new Int32Array(origins.t.length);
  }
  const texts = [];
  for (let k = 0; k < about.files.length; k++) texts.push(packages.has("text-" + k) ? await packed("text-" + k) : new Uint8Array());
  return {about, strokes, curves, joints, origins, texts};
}

/** Return the number of values in a sorted array that are at most `value`. */
function upTo(array, value) {
  let low = 0, high = array.length;
  while (low < high) {
    const middle = low + high >> 1;
    if (array[middle] <= value) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Return a number with `count` significant digits, without trailing zeros. */
function digits(value, count = 4) {
  if (!value) return "0";
  const shown = Math.abs(value) >= 10 ** count ? Math.round(value).toString() : Number(value.toPrecision(count)).toString();
  return shown.replace("-", "\u2212");
}

/** Return seconds as text: h:mm:ss.mmm, or seconds below a minute. */
function clock(seconds) {
  if (seconds < 60) return seconds.toFixed(3) + " s";
  const whole = Math.floor(seconds), two = value => String(value).padStart(2, "0");
  const rest = two(Math.floor(whole / 60) % 60) + ":" + two(whole % 60) + "." + String(Math.floor((seconds - whole) * 1000)).padStart(3, "0");
  return whole >= 3600 ? Math.floor(whole / 3600) + ":" + rest : rest.replace(/^0/, "");
}
