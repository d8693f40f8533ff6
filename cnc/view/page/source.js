// The text of the programs beside the path. Only visible rows exist as elements, and only visible bytes are decoded.

const ROW = 18;              // pixels, as in page.css
const TALLEST = 8e6;         // pixels; browsers limit the height of elements
const LONGEST = 400;         // characters of a line that are displayed
const HIDDEN = /[\u0000-\u0008\u000b-\u001f\u007f-\u009f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]/g;

/** Return the start of each line, and the end of the text. A line ends with \r\n, \n or \r. */
function lineStarts(bytes) {
  let starts = new Uint32Array(1024), count = 0, n = bytes.length;
  let i = n > 2 && bytes[0] === 0xef && bytes[1] === 0xbb && bytes[2] === 0xbf ? 3 : 0;
  const add = at => {
    if (count === starts.length) {
      const larger = new Uint32Array(2 * count);
      larger.set(starts);
      starts = larger;
    }
    starts[count++] = at;
  };
  add(i);
  for (; i < n; i++) {
    const c = bytes[i];
    if (c > 13 || c !== 10 && c !== 13) continue;
    if (c === 13 && bytes[i + 1] === 10) i++;
    add(i + 1);
  }
  if (starts[count - 1] < n) add(n);
  return starts.slice(0, count);
}

/** Times of the lines of a file: rows of the origins by line, and the duration of each line. */
class LineTimes {
  constructor(origins, file, lines, end) {
    const {t, first, more} = origins, n = t.length;
    this.origins = origins;
    this.end = end;
    this.heads = new Uint32Array(lines + 2);
    this.seconds = new Float64Array(lines + 1);
    this.busy = new Uint8Array(lines + 1);
    let count = 0;
    for (let i = 0; i < n; i++) {
      if (origins.file[i] !== file || first[i] > lines) continue;
      this.heads[first[i] + 1]++;
      this.seconds[first[i]] += (i + 1 < n ? t[i + 1] : end) - t[i];
      for (let line = first[i]; line <= Math.min(first[i] + more[i], lines); line++) this.busy[line] = 1;
      count++;
    }
    for (let line = 0; line <= lines; line++) this.heads[line + 1] += this.heads[line];
    const free = this.heads.slice();
    this.rows = new Uint32Array(count);
    for (let i = 0; i < n; i++) if (origins.file[i] === file && first[i] <= lines) this.rows[free[first[i]]++] = i;
  }

  /** Return the times [from, to] in which a line is active. */
  spans(line) {
    if (!this.busy[line]) return [];
    let at = line;
    while (at > 0 && this.heads[at] === this.heads[at + 1]) at--;
    const {t, more} = this.origins, out = [];
    for (let k = this.heads[at]; k < this.heads[at + 1]; k++) {
      const i = this.rows[k];
      if (at + more[i] >= line) out.push([t[i], i + 1 < t.length ? t[i + 1] : this.end]);
    }
    return out;
  }
}

class Source {
  constructor(list, model, onLine) {
    this.list = list;
    this.model = model;
    this.rowsElement = list.querySelector("#source-rows");
    this.size = list.querySelector("#source-size");
    this.decoders = [new TextDecoder("utf-8", {fatal: true}), new TextDecoder("latin1")];
    this.top = 0;
    this.chosen = null;
    this.at = null;
    this.known = new Map();
    list.addEventListener("wheel", event => {
      event.preventDefault();
      this.scroll(this.top + event.deltaY / (event.deltaMode === 1 ? 1 : ROW));
    }, {passive: false});
    list.addEventListener("scroll", () => {
      if (Math.abs(list.scrollTop - this.wanted) > 1) this.scroll(list.scrollTop / this.perLine, true);
    });
    list.addEventListener("click", event => {
      const row = event.target.closest(".row");
      if (row) onLine(this.file, Number(row.dataset.line));
    });
    list.addEventListener("keydown", event => {
      const step = {ArrowDown: 1, ArrowUp: -1}[event.key];
      if (!step || !this.chosen) return;
      event.preventDefault();
      onLine(this.file, Math.min(Math.max((step > 0 ? this.chosen[1] : this.chosen[0]) + step, 1), this.count));
    });
    this.open(0);
  }

  /** Show a file by its index. */
  open(file) {
    if (file === this.file) return;
    this.file = file;
    let known = this.known.get(file);
    if (!known) {
      const starts = lineStarts(this.model.texts[file]), count = starts.length - 1;
      known = {starts, count, times: new LineTimes(this.model.origins, file, count, this.model.about.duration)};
      this.known.set(file, known);
    }
    Object.assign(this, known);
    this.chosen = this.at = null;
    this.findings = new Map();
    for (const [name, line, text] of this.model.about.findings) {
      if (name === file) this.findings.set(line, (this.findings.get(line) || "") + text + "\n");
    }
    this.layout();
    this.scroll(0);
  }

  layout() {
    const height = Math.min(this.count * ROW, TALLEST);
    this.size.style.height = height + "px";
    this.inSight = Math.max(this.list.clientHeight / ROW, 1);
    this.perLine = Math.max(height - this.list.clientHeight, 0) / Math.max(this.count - this.inSight, 1);
  }

  scroll(top, byBar = false) {
    this.top = Math.min(Math.max(top, 0), Math.max(this.count - this.inSight, 0));
    if (!byBar) this.list.scrollTop = this.top * this.perLine;
    this.wanted = this.list.scrollTop;
    this.draw();
  }

  /** Select lines [first, last] and scroll to them. */
  choose(first, last) {
    this.chosen = [first, last];
    if (first - 1 < this.top || last > this.top + this.inSight) this.scroll(first - 1 - this.inSight / 3);
    else this.draw();
  }

  line(number) {
    const bytes = this.model.texts[this.file].subarray(this.starts[number - 1], this.starts[number]);
    let text;
    try {
      text = this.decoders[0].decode(bytes);
    } catch {
      text = this.decoders[1].decode(bytes);
    }
    return text.replace(/[\r\n]+$/, "").replace(HIDDEN, "\u00b7");
  }

  draw() {
    const first = Math.floor(this.top) + 1, last = Math.min(first + Math.ceil(this.inSight), this.count), rows = [];
    for (let number = first; number <= last; number++) {
      const row = document.createElement("div"), label = document.createElement("i"), code = document.createElement("code");
      const time = document.createElement("u"), line = this.line(number);
      row.className = "row";
      row.dataset.line = number;
      if (this.chosen && number >= this.chosen[0] && number <= this.chosen[1]) row.classList.add("chosen");
      if (this.at && number >= this.at[0] && number <= this.at[1]) row.classList.add("at");
      label.textContent = number;
      if (this.findings.has(number)) {
        label.className = "found";
        row.title = this.findings.get(number).trimEnd();
      }
      for (const part of line.slice(0, LONGEST).split(/(\([^)]*\)?|;.*)/)) {
        const span = document.createElement(/^[(;]/.test(part) ? "em" : "span");
        span.textContent = part;
        code.append(span);
      }
      const seconds = this.times.seconds[number];
      time.textContent = seconds ? clock(seconds) : "";
      row.append(label, code, time);
      rows.push(row);
    }
    this.rowsElement.replaceChildren(...rows);
    this.rowsElement.style.transform = `translateY(${-(this.top % 1) * ROW}px)`;
  }
}
