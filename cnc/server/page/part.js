// The part that a simulated cut leaves: a grid of heights, drawn as a shaded surface into the scene of the toolpath.

const VERTEX = `#version 300 es
precision highp float;
in vec3 place;
uniform mat3 turn;
uniform vec3 target;
uniform vec2 screen;
uniform float scale, reach;
out vec3 seen;
void main() {
  seen = turn * (place - target);
  gl_Position = vec4(seen.xy * scale / (0.5 * screen), -seen.z / reach, 1.0);
}`;
// Each triangle is flat: its normal is that of the surface on the screen.
const FRAGMENT = `#version 300 es
precision highp float;
uniform vec3 shade;
in vec3 seen;
out vec4 colour;
void main() {
  vec3 normal = normalize(cross(dFdx(seen), dFdy(seen)));
  float light = 0.35 + 0.65 * max(dot(normal, normalize(vec3(-0.4, 0.5, 0.77))), 0.0);
  colour = vec4(shade * light, 1.0);
}`;

/** Return deflated bytes in base 64 as bytes. */
async function bytes(text) {
  const letters = atob(text), packed = Uint8Array.from(letters, letter => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Return a part with its corners (3 numbers each), measured from `origin`. */
export async function decoded(found, origin) {
  const raw = await bytes(found.heights), {nx, ny, x, y, box} = found, view = new DataView(raw.buffer);
  const places = new Float32Array(3 * nx * ny), [low, high] = box[2];
  for (let i = 0, k = 0; i < nx; i++) for (let j = 0; j < ny; j++, k++) {
    places[3 * k] = x[0] + (x[1] - x[0]) * (nx > 1 ? i / (nx - 1) : 0) - origin[0];
    places[3 * k + 1] = y[0] + (y[1] - y[0]) * (ny > 1 ? j / (ny - 1) : 0) - origin[1];
    places[3 * k + 2] = low + (high - low) * view.getUint16(2 * k, true) / 65535 - origin[2];
  }
  const corners = new Uint32Array(6 * (nx - 1) * (ny - 1));
  for (let i = 0, at = 0; i < nx - 1; i++) for (let j = 0; j < ny - 1; j++) {
    const a = i * ny + j, b = a + ny;
    corners.set([a, b, b + 1, a, b + 1, a + 1], at);
    at += 6;
  }
  return {places, corners};
}

/** A surface in the WebGL context of a scene. */
export class Part {
  constructor(gl, {places, corners}) {
    this.gl = gl;
    this.count = corners.length;
    const program = this.program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    const at = gl.getAttribLocation(program, "place");
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, places, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(at);
    gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    gl.bindVertexArray(null);
  }

  /** Draw the surface behind and between the strokes that the scene has drawn. */
  draw(scene, shade) {
    const {gl, program} = this, dpr = devicePixelRatio, place = name => gl.getUniformLocation(program, name);
    gl.useProgram(program);
    gl.uniformMatrix3fv(place("turn"), false, scene.turn());
    gl.uniform3fv(place("target"), scene.target);
    gl.uniform2f(place("screen"), scene.canvas.width, scene.canvas.height);
    gl.uniform1f(place("scale"), scene.scale * dpr);
    gl.uniform1f(place("reach"), 4 * scene.model.reach);
    gl.uniform3fv(place("shade"), shade);
    gl.bindVertexArray(this.array);
    gl.drawElements(gl.TRIANGLES, this.count, gl.UNSIGNED_INT, 0);
    gl.bindVertexArray(null);
    gl.useProgram(scene.program);
  }
}
