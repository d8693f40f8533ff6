// The path in space, as thin rectangles that face the viewer. The projection is parallel and keeps lengths comparable.
// The view has a direction (yaw, pitch), a centre, and a scale in pixels per millimetre.
//
// The points are in a texture, two texels each, and the vertices of the two triangles of a stroke read them there. One
// call draws any number of strokes. Instanced drawing would be slower in software rendering.

const TEXELS = 2048;  // in a row of the texture
const VERTEX = `#version 300 es
precision highp float;
precision highp int;
uniform highp sampler2D points;
uniform int stride;      // points from one stroke to the next
uniform mat3 turn;
uniform vec3 target;
uniform vec2 screen;
uniform float scale, width, reach;
uniform int channel;
uniform vec2 range;
out float part, time, along, light;
flat out float dashed;
vec4 texel(int k) { return texelFetch(points, ivec2(k % 2048, k / 2048), 0); }
void main() {
  int stroke = gl_VertexID / 6, corner = gl_VertexID % 6, first = 2 * stride * stroke;
  corner = corner < 3 ? corner : corner - 2;
  // x y z and time of the ends; feed, acceleration, jerk, millimetres along the line of a traverse
  vec4 from = texel(first), look = texel(first + 1), to = texel(first + 2);
  vec3 a = turn * (from.xyz - target), b = turn * (to.xyz - target);
  vec2 way = (b.xy - a.xy) * scale;
  float far = length(way);
  way = far > 1e-4 ? way / far : vec2(1.0, 0.0);
  float end = float(corner & 1), side = float(corner >> 1) * 2.0 - 1.0;
  vec3 here = mix(a, b, end);
  vec2 at = here.xy * scale + 0.5 * width * (way * (end * 2.0 - 1.0) + vec2(-way.y, way.x) * side);
  gl_Position = vec4(at / (0.5 * screen), -here.z / reach, 1.0);
  time = mix(from.w, to.w, end);
  float value = channel == 0 ? look.x : channel == 1 ? look.y : channel == 2 ? look.z : time;
  part = clamp((value - range.x) / (range.y - range.x), 0.0, 1.0);
  dashed = look.w > 1e29 ? 0.0 : 1.0;
  vec3 move = to.xyz - from.xyz, size = abs(move);
  float most = 0.5 * max(size.x, max(size.y, size.z)), sense = size.x > most ? move.x : size.y > most ? move.y : move.z;
  along = look.w + end * length(move) * sign(sense);
  // Lines across the light are brighter than lines along it, so that surfaces have a shape.
  float towards = dot(b - a, vec3(-0.48, 0.6, 0.64)) / max(distance(a, b), 1e-9);
  light = 0.7 + 0.3 * sqrt(max(1.0 - towards * towards, 0.0));
}`;
const FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 ramp[8];
uniform vec3 paper, rapid;
uniform vec4 paint;      // instead of the ramp, if the last is not 0
uniform float now, dash;
in float part, time, along, light;
flat in float dashed;
out vec4 colour;
void main() {
  if (dashed > 0.5 && fract(along / dash) > 0.55) discard;
  float place = part * 7.0;
  int k = int(min(place, 6.0));
  vec3 shade = dashed > 0.5 ? rapid : light * mix(ramp[k], ramp[k + 1], place - float(k));
  if (paint.a > 0.0) shade = paint.rgb;
  colour = vec4(time > now ? mix(paper, shade, 0.4) : shade, 1.0);
}`;
const SLOW = 45, QUICK = 20;  // ms for a frame: above the first the path is drawn coarser, below the second finer
const MANY = 100000;         // strokes; a path with more of them is first drawn coarsely, as at the first motion of the view
const COARSE = 8;
const REST = 300;            // ms without a motion after which the view is at rest
const VIEWS = {"3d": [0.6, 0.55], top: [0, Math.PI / 2], front: [0, 0], side: [Math.PI / 2, 0]};

class Scene {
  constructor(canvas, model, boxesShown) {
    this.canvas = canvas;
    this.model = model;
    this.shown = boxesShown;
    this.levels = levels(model.strokes, model.size, model.about.tolerance);
    this.pace = model.strokes.n > MANY ? COARSE : 1;  // grows while frames are slow
    this.coarse = 1;     // that of the next frame
    this.target = [0, 0, 0];
    this.chosen = null;
    const gl = this.gl = canvas.getContext("webgl2", {antialias: true, alpha: false});
    if (gl) this.prepare();
    if (this.pace > 1) this.makeAhead(this.levels.length - 1);
  }

  /** Make the coarser levels while nobody waits for them: in a frame this would be seen. */
  makeAhead(k) {
    if (k > 0) (window.requestIdleCallback ?? setTimeout)(() => {
      this.levels[k].few;
      this.makeAhead(k - 1);
    });
  }

  prepare() {
    const gl = this.gl, program = this.program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) {
      if (!gl.isContextLost()) throw new Error(gl.getProgramInfoLog(program));
      return;
    }
    gl.useProgram(program);
    this.uniforms = {};
    for (let i = 0; i < gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS); i++) {
      const name = gl.getActiveUniform(program, i).name;
      this.uniforms[name.replace("[0]", "")] = gl.getUniformLocation(program, name);
    }
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    for (const {made, cover} of this.levels) for (const strokes of [made, cover]) if (strokes) strokes.texture = null;  // created at the first use
    this.lines = this.shown.map(box => ({...box, texture: this.texture(box.data)}));
    if (this.chosen) this.chosen.texture = this.texture(this.chosen.data);
  }

  texture(data) {
    const gl = this.gl, texture = gl.createTexture(), rows = Math.ceil(data.length / (4 * TEXELS)), whole = new Float32Array(4 * TEXELS * rows);
    whole.set(data);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, TEXELS, rows, 0, gl.RGBA, gl.FLOAT, whole);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    return texture;
  }

  /** Set the strokes to draw over the others; null for none. */
  choose(data) {
    if (this.gl && this.chosen) this.gl.deleteTexture(this.chosen.texture);
    this.chosen = data && {data, texture: this.gl && this.texture(data)};
  }

  look(name) {
    [this.yaw, this.pitch] = VIEWS[name];
    this.fit();
  }

  fit() {
    const low = [Infinity, Infinity], high = [-Infinity, -Infinity], turn = this.turn();
    for (const {data} of [this.levels.at(-1), ...this.shown.filter(box => box.whole)]) {
      for (let i = 0; i < data.length; i += FLOATS) {
        for (let k = 0; k < 2; k++) {
          const value = turn[k] * data[i] + turn[3 + k] * data[i + 1] + turn[6 + k] * data[i + 2];
          low[k] = Math.min(low[k], value);
          high[k] = Math.max(high[k], value);
        }
      }
    }
    const [width, height] = [this.canvas.clientWidth - 80, this.canvas.clientHeight - 100];
    const extent = [high[0] - low[0], high[1] - low[1]].map(each => Math.max(each, 1e-3 * this.model.size, 1e-6));
    this.scale = Math.max(Math.min(width / extent[0], height / extent[1]), 1e-6);
    const [x, y] = [(low[0] + high[0]) / 2, (low[1] + high[1]) / 2];
    this.target = [0, 1, 2].map(k => turn[3 * k] * x + turn[3 * k + 1] * y);
  }

  /** Return the columns of the matrix from machine axes to right, up and towards the viewer. */
  turn() {
    const [c, s, cp, sp] = [Math.cos(this.yaw), Math.sin(this.yaw), Math.cos(this.pitch), Math.sin(this.pitch)];
    // On a lathe Z takes the place of X, and X that of Z.
    return this.lathe ? [0, cp, sp, -s, -c * sp, c * cp, c, -s * sp, s * cp] : [c, -s * sp, s * cp, s, c * sp, -c * cp, 0, cp, sp];
  }

  /** Return the place of a point on the screen in CSS pixels from the upper left, and its depth. */
  project(x, y, z) {
    const m = this.turn(), [tx, ty, tz] = this.target, [a, b, c] = [x - tx, y - ty, z - tz];
    const right = m[0] * a + m[3] * b + m[6] * c, up = m[1] * a + m[4] * b + m[7] * c;
    return [this.canvas.clientWidth / 2 + right * this.scale, this.canvas.clientHeight / 2 - up * this.scale,
      m[2] * a + m[5] * b + m[8] * c];
  }

  move(dx, dy) {
    const m = this.turn();
    this.target = this.target.map((each, k) => each - (m[3 * k] * dx - m[3 * k + 1] * dy) / this.scale);
  }

  rotate(dx, dy) {
    this.yaw -= dx * 0.008;
    this.pitch = Math.min(Math.max(this.pitch + dy * 0.008, -Math.PI / 2), Math.PI / 2);
  }

  /** Magnify by a factor around a point of the screen. */
  zoom(factor, x, y) {
    const [dx, dy] = [x - this.canvas.clientWidth / 2, y - this.canvas.clientHeight / 2];
    factor = Math.min(Math.max(this.scale * factor, 1e-3), 1e6) / this.scale;
    this.move(-dx, -dy);
    this.scale *= factor;
    this.move(dx, dy);
  }

  /** The view moves: draw coarsely enough to keep up, judged by the duration of the last frames, and finely at rest. */
  moving(redraw, isHeld = () => false) {
    if (!this.timed) {
      this.timed = true;
      requestAnimationFrame(begin => requestAnimationFrame(end => {
        this.timed = false;
        const took = end - begin;
        if (took > SLOW) this.pace = Math.min(this.pace * Math.min(took / SLOW, 4), 64);
        else if (took < QUICK) this.pace = Math.max(this.pace / 1.2, 1);
      }));
    }
    const rest = () => {
      if (isHeld()) return this.resting = setTimeout(rest, REST);
      this.coarse = 1;
      redraw();
    };
    this.coarse = this.pace;
    clearTimeout(this.resting);
    this.resting = setTimeout(rest, REST);
    redraw();
  }

  /** Return the coarsest level with a tolerance that is invisible at this scale. */
  level() {
    const seen = 0.4 * this.coarse / (this.scale * devicePixelRatio);
    let found = this.levels[0];
    for (const level of this.levels) if (level.tolerance <= seen) found = level;
    return found;
  }

  /** Yield runs [first, last) of blocks that overlap a rectangle of the screen, in CSS pixels. */
  *visible(strokes, left, top, right, bottom) {
    const m = this.turn(), {boxes} = strokes, n = boxes.length / 6;
    const [w, h, s] = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2, this.scale];
    let first = -1;
    for (let b = 0; b <= n; b++) {
      let inside = b < n;
      if (inside) {
        let x = 0, y = 0, rx = 0, ry = 0;
        for (let k = 0; k < 3; k++) {
          const middle = (boxes[6 * b + k] + boxes[6 * b + 3 + k]) / 2 - this.target[k], half = (boxes[6 * b + 3 + k] - boxes[6 * b + k]) / 2;
          x += m[3 * k] * middle;
          y += m[3 * k + 1] * middle;
          rx += Math.abs(m[3 * k]) * half;
          ry += Math.abs(m[3 * k + 1]) * half;
        }
        const [px, py] = [w + x * s, h - y * s];
        inside = px + rx * s >= left && px - rx * s <= right && py + ry * s >= top && py - ry * s <= bottom;
      }
      if (inside && first < 0) first = b;
      if (!inside && first >= 0) {
        yield [first, b];
        first = -1;
      }
    }
  }

  draw({channel, range, ramp, paper, rapid, accent, now}) {
    const gl = this.gl;
    if (!gl || gl.isContextLost()) return;
    const dpr = devicePixelRatio, w = Math.round(this.canvas.clientWidth * dpr), h = Math.round(this.canvas.clientHeight * dpr);
    if (this.canvas.width !== w || this.canvas.height !== h) [this.canvas.width, this.canvas.height] = [w, h];
    gl.viewport(0, 0, w, h);
    gl.clearColor(...paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const u = this.uniforms;
    gl.uniformMatrix3fv(u.turn, false, this.turn());
    gl.uniform3fv(u.target, this.target);
    gl.uniform2f(u.screen, w, h);
    gl.uniform1f(u.scale, this.scale * dpr);
    gl.uniform1f(u.reach, 4 * this.model.reach);
    gl.uniform1i(u.channel, channel);
    gl.uniform2fv(u.range, range);
    gl.uniform3fv(u.ramp, ramp.flat());
    gl.uniform3fv(u.paper, paper);
    gl.uniform3fv(u.rapid, rapid);
    // Dashes of about nine pixels, in powers of two, so that they do not move while the user zooms.
    gl.uniform1f(u.dash, 2 ** Math.round(Math.log2(9 / this.scale)));
    gl.uniform1f(u.now, Infinity);
    for (const line of this.lines) this.strokes(line, 0, line.data.length / FLOATS / 2, 1.1 * dpr, [...line.colour(), 1], 2);
    gl.uniform1f(u.now, now);
    const level = this.level(), wide = level.n < 20000 ? 2 : level.n < 100000 ? 1.5 : 1.1;
    this.drawn = 0;
    // Long strokes close to each other take most of the time, and hide each other.
    const strokes = this.coarse > 1 ? level.few : level.all;
    strokes.texture ??= this.texture(strokes.data);
    for (const [first, last] of this.visible(strokes, 0, 0, this.canvas.clientWidth, this.canvas.clientHeight)) {
      const end = Math.min(last * BLOCK, strokes.count);
      this.strokes(strokes, first * BLOCK, end, wide * dpr, [0, 0, 0, 0], strokes.stride);
      this.drawn += end - first * BLOCK;
    }
    if (this.chosen) {
      gl.disable(gl.DEPTH_TEST);
      gl.uniform1f(u.now, Infinity);
      this.strokes(this.chosen, 0, this.chosen.data.length / FLOATS / 2, 3 * dpr, [...accent, 1], 2);
      gl.enable(gl.DEPTH_TEST);
    }
  }

  /** Draw strokes [first, last): from each point to the next (`stride` 1), or of pairs (2). */
  strokes({texture}, first, last, width, paint, stride) {
    const gl = this.gl;
    if (last <= first) return;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.uniform1i(this.uniforms.stride, stride);
    gl.uniform1f(this.uniforms.width, width);
    gl.uniform4fv(this.uniforms.paint, paint);
    gl.drawArrays(gl.TRIANGLES, 6 * first, 6 * (last - first));
  }

  /** Return the time of the path point nearest to a point of the screen; null beyond `near` pixels. */
  pick(x, y, near) {
    const level = this.level(), {data} = level, m = this.turn(), s = this.scale, [tx, ty, tz] = this.target;
    const [w, h] = [this.canvas.clientWidth / 2, this.canvas.clientHeight / 2];
    let best = near * near, bestDepth = -Infinity, found = null;
    const point = o => {
      const [a, b, c] = [data[o] - tx, data[o + 1] - ty, data[o + 2] - tz];
      px = w + (m[0] * a + m[3] * b + m[6] * c) * s - x;
      py = h - (m[1] * a + m[4] * b + m[7] * c) * s - y;
      pz = m[2] * a + m[5] * b + m[8] * c;
    };
    let px = 0, py = 0, pz = 0;
    for (const [first, last] of this.visible(level.all, x - near, y - near, x + near, y + near)) {
      point(first * BLOCK * FLOATS);
      for (let i = first * BLOCK; i < Math.min(last * BLOCK, level.n - 1); i++) {
        const [ax, ay, az] = [px, py, pz];
        point((i + 1) * FLOATS);
        const [dx, dy] = [px - ax, py - ay], square = dx * dx + dy * dy;
        const part = square > 0 ? Math.min(Math.max(-(ax * dx + ay * dy) / square, 0), 1) : 0;
        const off = (ax + part * dx) ** 2 + (ay + part * dy) ** 2, depth = az + part * (pz - az);
        // Of points at nearly the same distance the one in front counts.
        if (off < best - 2 || off < best + 2 && off < near * near && depth > bestDepth) {
          best = Math.min(best, off);
          bestDepth = depth;
          found = data[i * FLOATS + 3] + part * (data[(i + 1) * FLOATS + 3] - data[i * FLOATS + 3]);
        }
      }
    }
    return found;
  }
}
