// The street in three.js: the server's tiles and models, and of each tick what moves. No street is built here.

import {
  BufferAttribute, BufferGeometry, DataTexture, DoubleSide, GLSL3, InstancedBufferAttribute, InstancedMesh, Matrix4, Mesh, MultiplyBlending, RawShaderMaterial,
  Scene, SphereGeometry, Vector3,
} from "./three.js";

export const RANGE_M = 160;
// What a template is, see `Template`: lamps stand between vehicles and people.
const LAMP = 23, WALKER = 31;
export const isLamp = (row) => row.template >= LAMP && row.template < WALKER;
export const isWalker = (row) => row.template >= WALKER;
const CAPACITY = 96, CORNERS = 300; // of a template, and of a line on the ground
const HEAD_BYTES = 52, ROW_BYTES = 22;

// --- shaders: the colours and patterns are those of the rasteriser, see `raster.py` ---

const HAZE = `
uniform vec3 uEye; uniform float uRange;
vec3 haze(vec3 rgb, vec3 p) {
  float share = max(0., distance(p, uEye) / uRange - .25);
  return mix(rgb, vec3(.839, .882, .918), min(1., share * share * 1.6));
}`;
const STREET_VERTEX = `
precision highp float;
uniform mat4 projectionMatrix, modelViewMatrix;
in vec3 position; in vec3 rgb; in float pattern; in vec4 frame;
flat out vec3 vRgb; flat out float vPattern; flat out vec4 vFrame; out vec3 vP;
void main() {
  vRgb = rgb; vPattern = pattern; vFrame = frame; vP = position;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.);
}`;
const STREET_FRAGMENT = `
precision highp float;
flat in vec3 vRgb; flat in float vPattern; flat in vec4 vFrame; in vec3 vP; out vec4 colour;
uniform vec2 uFrom; uniform float uFine;
${HAZE}
float dice(vec2 p) { p = fract(p * vec2(.1031, .1030)); p += dot(p, p.yx + 33.33); return fract((p.x + p.y) * p.x); }
float noise(vec2 p) {
  vec2 i = floor(p), f = fract(p); f = f * f * (3. - 2. * f);
  return mix(mix(dice(i), dice(i + vec2(1, 0)), f.x), mix(dice(i + vec2(0, 1)), dice(i + vec2(1, 1)), f.x), f.y);
}
float edge(float from, float to, float at) { return clamp((at - from) / max(to - from, 1e-5), 0., 1.); }
void main() {
  vec3 c = vRgb;
  float far = distance(vP, uEye), near = 1. - min(far * .04, .85);
  vec2 p = vP.xy;
  if (vPattern < .5) {
  } else if (vPattern < 1.5) { // stripes of a zebra
    float bay = dot(p + uFrom, vFrame.xy) - vFrame.z, soft = fwidth(bay) + 1e-4;
    float d = abs(fract(bay - .25) - .5) - .25;
    c = mix(c, vec3(.925, .925, .91), edge(-soft, soft, d) * (.93 + .07 * noise(p * 9.)));
  } else if (vPattern < 2.5) { // windows
    float bay = dot(p + uFrom, vFrame.xy) - vFrame.z, storey = (vP.z - vFrame.w) / 3.2;
    vec2 at = vec2(abs(fract(bay) - .5), abs(fract(storey) - .53)), soft = vec2(fwidth(bay), fwidth(storey)) + 1e-4;
    float pane = edge(.225 + soft.x, .225 - soft.x, at.x) * edge(.225 + soft.y, .225 - soft.y, at.y);
    float rim = edge(.262 + soft.x, .262 - soft.x, at.x) * edge(.262 + soft.y, .262 - soft.y, at.y);
    float up = fract(storey);
    vec3 glass = mix(vec3(.25, .32, .38), vec3(.50, .60, .70), clamp(up * 1.1 - .3 + .25 * dice(floor(vec2(bay, storey))), 0., 1.));
    c *= .96 + .06 * noise(vec2(bay * 3., storey * 5.));
    c = mix(c, c * .55 + .42, rim * .8);
    c = mix(c, glass, pane);
    float above = vP.z - vFrame.w;
    if (above < .9) c *= .66 + .34 * clamp(above / .9, 0., 1.);
  } else if (vPattern < 3.5) { // slabs
    vec2 q = p / .6; float line = floor(q.y); q.x += mod(line, 2.) * .5;
    vec2 cell = vec2(floor(q.x), line), at = abs(fract(q) - .5);
    float soft = max(fwidth(q.x), fwidth(q.y)) * .7 + .004, joint = edge(.488 - soft, .488 + soft, max(at.x, at.y));
    float fade = clamp(.06 / soft, 0., 1.);
    c *= .965 + near * (.055 * (2. * dice(cell) - 1.) + .03 * (noise(p * 14.) - .5));
    c *= 1. - .26 * joint * fade;
  } else { // asphalt, grass
    bool grass = vPattern > 4.5;
    float grain = noise(p * (grass ? 1.3 : .55));
    if (uFine > .5 && far < 24.) grain = .5 * grain + .5 * mix(.5, noise(p * (grass ? 7. : 19.)), clamp(2. - far / 12., 0., 1.));
    c *= 1. + (grass ? .20 : .12) * (grain - .5) * (.35 + near);
  }
  colour = vec4(haze(c, vP), 1.);
}`;
const ACTOR_VERTEX = `
precision highp float;
uniform mat4 projectionMatrix, modelViewMatrix; uniform sampler2D uPaints;
in vec3 position; in vec3 normal; in float paint; in mat4 instanceMatrix; in vec3 look;
flat out vec3 vRgb; out vec3 vP;
void main() {
  // 1. The paint: lamps that are lit, and of each actor its own colours.
  int number = int(paint + .5), lamps = int(look.z + .5);
  if (number == 4 && (lamps & 8) != 0) number = 22;
  if ((number == 19 && (lamps & 6) != 0) || (number == 20 && (lamps & 5) != 0)) number = 23;
  uint seed = uint(look.x + .5) | (uint(look.y + .5) << 16);
  uint variant = number < 16 ? ((seed ^ (seed >> 9)) >> uint(number * 2)) & 15u : 0u;
  vec3 rgb = texelFetch(uPaints, ivec2(int(variant), number), 0).rgb;
  // 2. Its light: a unit box is stretched, so a normal is stretched the other way.
  vec3 size2 = vec3(dot(instanceMatrix[0].xyz, instanceMatrix[0].xyz), dot(instanceMatrix[1].xyz, instanceMatrix[1].xyz), dot(instanceMatrix[2].xyz, instanceMatrix[2].xyz));
  vec3 n = normalize(mat3(instanceMatrix) * (normal / size2));
  float shade = number >= 22 ? 1. : .60 + .46 * max(0., dot(n, vec3(-.4204, -.5505, .7207)));
  vRgb = rgb * shade * (number >= 22 ? 1. : .86 + .14 * clamp(position.z * 2.5, 0., 1.));
  vec4 p = instanceMatrix * vec4(position, 1.);
  vP = p.xyz;
  gl_Position = projectionMatrix * modelViewMatrix * p;
}`;
const ACTOR_FRAGMENT = `
precision highp float;
flat in vec3 vRgb; in vec3 vP; out vec4 colour;
${HAZE}
void main() { colour = vec4(haze(vRgb, vP), 1.); }`;
const FLAT_VERTEX = `
precision highp float;
uniform mat4 projectionMatrix, modelViewMatrix;
in vec3 position; in mat4 instanceMatrix;
out vec2 vAt;
void main() { vAt = position.xy; gl_Position = projectionMatrix * modelViewMatrix * instanceMatrix * vec4(position, 1.); }`;
const SHADOW_FRAGMENT = `
precision highp float;
in vec2 vAt; out vec4 colour;
void main() { float q = min(1., dot(vAt, vAt)); colour = vec4(vec3(.42 + .58 * q * q), 1.); }`;
const DISC_FRAGMENT = `
precision highp float;
uniform vec3 uRgb; in vec2 vAt; out vec4 colour;
void main() { float r = length(vAt); if (r > 1.) discard; colour = vec4(r > .78 ? vec3(1.) : uRgb, 1.); }`;
const CROSS_FRAGMENT = `
precision highp float;
in vec2 vAt; out vec4 colour;
void main() {
  float d = min(abs(vAt.x - vAt.y), abs(vAt.x + vAt.y));
  if (d > .42) discard;
  colour = vec4(d > .24 ? vec3(1.) : vec3(.77, .12, .23), 1.);
}`;
const PLAIN_VERTEX = `
precision highp float;
uniform mat4 projectionMatrix, modelViewMatrix;
in vec3 position;
out vec3 vAt;
void main() { vAt = position; gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.); }`;
const SKY_FRAGMENT = `
precision highp float;
in vec3 vAt; out vec4 colour;
void main() {
  float up = clamp(normalize(vAt).z * 1.8, 0., 1.);
  colour = vec4(mix(vec3(.839, .882, .918), vec3(.44, .627, .839), up), 1.);
}`;
const RGB_FRAGMENT = `
precision highp float;
uniform vec3 uRgb; out vec4 colour;
void main() { colour = vec4(uRgb, 1.); }`;

function material(vertexShader, fragmentShader, uniforms = {}, more = {}) {
  return new RawShaderMaterial({ glslVersion: GLSL3, vertexShader, fragmentShader, uniforms, ...more });
}

function plane(corners) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(corners), 3));
  return geometry;
}

// The corners of a line, in the buffer that it has.
function fill(mesh, numbers) {
  const { geometry } = mesh, places = geometry.attributes.position, count = Math.min(numbers.length, 3 * CORNERS);
  places.array.set(numbers.slice(0, count));
  places.needsUpdate = true;
  geometry.setDrawRange(0, count / 3);
}

const SQUARE = [-1, -1, 0, 1, -1, 0, 1, 1, 0, -1, -1, 0, 1, 1, 0, -1, 1, 0];
const ON_GROUND = { depthWrite: false, polygonOffset: true, polygonOffsetFactor: -2, polygonOffsetUnits: -8, side: DoubleSide };

// What is laid on the ground many times: discs of the route, shadows, crosses.
class Laid {
  constructor(scene, fragment, capacity, uniforms, more, order) {
    this.mesh = new InstancedMesh(plane(SQUARE), material(FLAT_VERTEX, fragment, uniforms, { ...ON_GROUND, ...more }), capacity);
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = order;
    this.mesh.count = 0;
    this.capacity = capacity;
    this.matrix = new Matrix4();
    scene.add(this.mesh);
  }

  // Each [x, y, z, half length, half width, yaw].
  lay(places) {
    this.mesh.count = Math.min(places.length, this.capacity);
    for (let i = 0; i < this.mesh.count; i++) {
      const [x, y, z, a, b, yaw] = places[i];
      const c = Math.cos(yaw), s = Math.sin(yaw);
      this.mesh.setMatrixAt(i, this.matrix.set(c * a, -s * b, 0, x, s * a, c * b, 0, y, 0, 0, 1, z, 0, 0, 0, 1));
    }
    this.mesh.instanceMatrix.needsUpdate = true;
  }
}

// --- buffers of the server ---

class Reader {
  constructor(buffer) { this.buffer = buffer; this.at = 0; }
  take(Kind, count) {
    const bytes = count * Kind.BYTES_PER_ELEMENT;
    if (count < 0 || this.at + bytes > this.buffer.byteLength) throw new RangeError("a buffer of the street is too short");
    const part = new Kind(this.buffer.slice(this.at, this.at + bytes));
    this.at += bytes;
    return part;
  }
}

// One block of triangles, see `_block` in street_scene.py: each face with its own corners, as it has its own colour.
function blockOf(reader, from) {
  const [vertexCount, faceCount, framedCount] = reader.take(Uint32Array, 3);
  const vertices = reader.take(Float32Array, 3 * vertexCount), faces = reader.take(Uint32Array, 3 * faceCount);
  const words = reader.take(Uint32Array, faceCount), frames = reader.take(Float32Array, 4 * framedCount);
  if (!faceCount) return null;
  const position = new Float32Array(9 * faceCount), rgb = new Uint8Array(9 * faceCount), pattern = new Uint8Array(3 * faceCount), frame = new Float32Array(12 * faceCount);
  for (let face = 0; face < faceCount; face++) {
    const word = words[face];
    for (let k = 0; k < 3; k++) {
      const corner = 3 * face + k, vertex = faces[corner];
      for (let axis = 0; axis < 3; axis++) position[3 * corner + axis] = vertices[3 * vertex + axis] - from[axis];
      for (let axis = 0; axis < 3; axis++) rgb[3 * corner + axis] = (word >>> (8 * axis)) & 255;
      pattern[corner] = word >>> 24;
      if (face < framedCount) frame.set(frames.subarray(4 * face, 4 * face + 4), 4 * corner);
      if (face < framedCount) frame[4 * corner + 3] -= from[2];
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(position, 3));
  geometry.setAttribute("rgb", new BufferAttribute(rgb, 3, true));
  geometry.setAttribute("pattern", new BufferAttribute(pattern, 1));
  geometry.setAttribute("frame", new BufferAttribute(frame, 4));
  geometry.computeBoundingSphere();
  if (!Number.isFinite(geometry.boundingSphere.radius)) throw new RangeError("a tile of the street has places that are no numbers");
  return geometry;
}

function modelsOf(buffer) {
  const reader = new Reader(buffer);
  const [count, vertexCount, faceCount, paintCount] = reader.take(Uint32Array, 4);
  const verticesOf = reader.take(Uint32Array, count + 1), facesOf = reader.take(Uint32Array, count + 1);
  const vertices = reader.take(Float32Array, 3 * vertexCount), faces = reader.take(Uint32Array, 3 * faceCount);
  const paints = reader.take(Uint8Array, 48 * paintCount), paintOf = reader.take(Uint8Array, faceCount);
  const rgba = new Uint8Array(64 * paintCount);
  for (let i = 0; i < 16 * paintCount; i++) rgba.set([paints[3 * i], paints[3 * i + 1], paints[3 * i + 2], 255], 4 * i);
  const texture = new DataTexture(rgba, 16, paintCount);
  texture.needsUpdate = true;
  const geometries = Array.from({ length: count }, (_, model) => {
    const first = facesOf[model], number = facesOf[model + 1] - first;
    const position = new Float32Array(9 * number), paint = new Uint8Array(3 * number);
    for (let corner = 0; corner < 3 * number; corner++) {
      const vertex = verticesOf[model] + faces[3 * first + corner];
      position.set(vertices.subarray(3 * vertex, 3 * vertex + 3), 3 * corner);
      paint[corner] = paintOf[first + Math.floor(corner / 3)];
    }
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(position, 3));
    geometry.setAttribute("paint", new BufferAttribute(paint, 1));
    geometry.computeVertexNormals();
    return geometry;
  });
  return { geometries, texture };
}

// A tick, see `scene_to_buffer`: places in W, each row by its id.
export function tickOf(buffer) {
  const view = new DataView(buffer), float = (at) => view.getFloat32(at, true);
  const p = [0, 8, 16].map((at) => view.getFloat64(at, true));
  const [yaw, pitch, roll, speed, turn, done] = [24, 28, 32, 36, 40, 44].map(float);
  const count = view.getUint16(48, true), jumped = view.getUint16(50, true) > 0;
  if (![...p, yaw, pitch, roll, speed, turn, done].every(Number.isFinite)) throw new RangeError("a tick has places that are no numbers");
  const rows = new Map();
  for (let i = 0; i < count; i++) {
    const at = HEAD_BYTES + ROW_BYTES * i;
    const centi = (k) => view.getInt16(at + 4 + 2 * k, true) / 100, size = (k) => view.getUint16(at + 10 + 2 * k, true) / 100;
    let id = view.getUint32(at, true);
    while (rows.has(id)) id += 4294967296; // lamps have no id of their own
    rows.set(id, {
      id, seed: id % 4294967296, p: [p[0] + centi(0), p[1] + centi(1), p[2] + centi(2)], size: [size(0), size(1), size(2)],
      yaw: view.getInt16(at + 16, true) / 1e4, pitch: view.getInt8(at + 18) / 100, roll: view.getInt8(at + 19) / 100,
      template: view.getUint8(at + 20), lamps: view.getUint8(at + 21),
    });
  }
  return { p, yaw, pitch, roll, speed, turn, done, jumped, rows };
}

export const between = (a, b, share) => a + (b - a) * share;
export const betweenAngles = (a, b, share) => a + Math.atan2(Math.sin(b - a), Math.cos(b - a)) * share;

// --- the street ---

export class Street3D {
  constructor() {
    this.scene = new Scene();
    this.from = [0, 0, 0]; // where the scene's origin lies in W: numbers of a graphics card are small
    this.uniforms = { uEye: { value: new Vector3() }, uRange: { value: RANGE_M }, uFrom: { value: { x: 0, y: 0 } }, uFine: { value: 1 } };
    this.street = material(STREET_VERTEX, STREET_FRAGMENT, this.uniforms);
    this.marks = material(STREET_VERTEX, STREET_FRAGMENT, this.uniforms, { polygonOffset: true, polygonOffsetFactor: -1, polygonOffsetUnits: -4, depthWrite: false });
    this.tiles = new Map(); // name -> meshes, or null while it is on its way
    this.models = null;
    this.byTemplate = new Map();
    const sky = new Mesh(new SphereGeometry(1, 24, 12), material(PLAIN_VERTEX, SKY_FRAGMENT, {}, { side: DoubleSide, depthWrite: false, depthTest: false }));
    sky.frustumCulled = false;
    sky.renderOrder = -10;
    this.sky = sky;
    this.scene.add(sky);
    this.shadows = new Laid(this.scene, SHADOW_FRAGMENT, CAPACITY, {}, { transparent: true, blending: MultiplyBlending, premultipliedAlpha: true }, 2);
    this.dots = new Laid(this.scene, DISC_FRAGMENT, 64, { uRgb: { value: new Vector3(0, 0.478, 0.369) } }, { transparent: true }, 3);
    this.crosses = new Laid(this.scene, CROSS_FRAGMENT, 128, {}, { transparent: true, depthTest: false }, 5);
    this.track = this.line([0.063, 0.361, 0.722], 4, { depthTest: false, transparent: true });
    this.flag = this.line([0.769, 0.118, 0.227], 4, {});
  }

  line(rgb, order, more) {
    const mesh = new Mesh(plane(new Array(3 * CORNERS).fill(0)), material(PLAIN_VERTEX, RGB_FRAGMENT, { uRgb: { value: new Vector3(...rgb) } }, { side: DoubleSide, ...more }));
    mesh.frustumCulled = false;
    mesh.renderOrder = order;
    this.scene.add(mesh);
    return mesh;
  }

  // Another street begins.
  clear(from) {
    for (const name of [...this.tiles.keys()]) this.drop(name);
    this.from = from;
    this.uniforms.uFrom.value = { x: from[0], y: from[1] };
    this.way = null;
  }

  drop(name) {
    for (const mesh of this.tiles.get(name) ?? []) { this.scene.remove(mesh); mesh.geometry.dispose(); }
    this.tiles.delete(name);
  }

  addTile(name, buffer) {
    const reader = new Reader(buffer), meshes = [];
    for (const kind of [this.street, this.marks]) {
      const geometry = blockOf(reader, this.from);
      if (!geometry) continue;
      const mesh = new Mesh(geometry, kind);
      mesh.matrixAutoUpdate = false;
      mesh.renderOrder = kind === this.marks ? 1 : 0;
      this.scene.add(mesh);
      meshes.push(mesh);
    }
    this.tiles.set(name, meshes);
  }

  addModels(buffer) {
    for (const mesh of this.byTemplate.values()) this.scene.remove(mesh);
    this.byTemplate.clear();
    this.models = modelsOf(buffer);
    const uniforms = { uEye: this.uniforms.uEye, uRange: this.uniforms.uRange, uPaints: { value: this.models.texture } };
    this.actor = material(ACTOR_VERTEX, ACTOR_FRAGMENT, uniforms);
  }

  // The walls that may stand between the chair and whoever looks at it.
  walls() {
    return [...this.tiles.values()].flatMap((meshes) => (meshes ?? []).filter((mesh) => mesh.material === this.street));
  }

  meshOf(template) {
    let mesh = this.byTemplate.get(template);
    if (!mesh) {
      const geometry = this.models.geometries[template].clone();
      mesh = new InstancedMesh(geometry, this.actor, CAPACITY);
      geometry.setAttribute("look", new InstancedBufferAttribute(new Float32Array(3 * CAPACITY), 3));
      mesh.frustumCulled = false;
      this.byTemplate.set(template, mesh);
      this.scene.add(mesh);
    }
    return mesh;
  }

  // Places what moves, rows as `tickOf` has them; `hidden` is the id of one that is not drawn.
  place(rows) {
    if (!this.models) return;
    const counts = new Map(), matrix = new Matrix4(), shadows = [];
    for (const row of rows) {
      if (row.template >= this.models.geometries.length) continue;
      const mesh = this.meshOf(row.template), at = counts.get(row.template) ?? 0;
      if (at >= CAPACITY) continue;
      counts.set(row.template, at + 1);
      const [x, y, z] = row.p.map((value, axis) => value - this.from[axis]), [l, w, h] = row.size;
      const cy = Math.cos(row.yaw), sy = Math.sin(row.yaw), cp = Math.cos(row.pitch), sp = Math.sin(row.pitch), cr = Math.cos(row.roll), sr = Math.sin(row.roll);
      mesh.setMatrixAt(at, matrix.set(
        cy * cp * l, (-cy * sp * sr - sy * cr) * w, (-cy * sp * cr + sy * sr) * h, x,
        sy * cp * l, (-sy * sp * sr + cy * cr) * w, (-sy * sp * cr - cy * sr) * h, y,
        sp * l, cp * sr * w, cp * cr * h, z, 0, 0, 0, 1));
      mesh.geometry.attributes.look.setXYZ(at, row.seed & 65535, row.seed >>> 16, row.lamps);
      if (!isLamp(row)) shadows.push([x, y, z + 0.03, 0.5 * l + 0.2, 0.5 * w + 0.2, row.yaw]);
    }
    for (const [template, mesh] of this.byTemplate) {
      mesh.count = counts.get(template) ?? 0;
      mesh.instanceMatrix.needsUpdate = mesh.geometry.attributes.look.needsUpdate = true;
    }
    this.shadows.lay(shadows);
  }

  // The route's points [x, y, z] in W ahead, and a flag at its end.
  showWay(points, goal, eye) {
    const dots = points.map(([x, y, z]) => [x - this.from[0], y - this.from[1], z - this.from[2], 0.13, 0.13, 0]);
    this.dots.lay(dots);
    if (!goal) { this.flag.visible = false; return; }
    this.flag.visible = true;
    const [x, y, z] = goal.map((value, axis) => value - this.from[axis]);
    const away = Math.atan2(eye.y - y, eye.x - x), c = -Math.sin(away), s = Math.cos(away);
    const at = (along, up) => [x + c * along, y + s * along, z + up];
    const quad = (a, b, low, high) => [...at(a, low), ...at(b, low), ...at(b, high), ...at(a, low), ...at(b, high), ...at(a, high)];
    fill(this.flag, [...quad(-0.03, 0.03, 0, 2.4), ...at(0, 2.4), ...at(0.85, 2.1), ...at(0, 1.8)]);
  }

  // Triangles [x, y, z] in W of the own track.
  showTrack(corners) {
    this.track.visible = corners.length > 0;
    fill(this.track, corners.flatMap(([x, y, z]) => [x - this.from[0], y - this.from[1], z - this.from[2]]));
  }

  showCrosses(places) {
    this.crosses.lay(places.map(([x, y, z, yaw]) => [x - this.from[0], y - this.from[1], z - this.from[2], 0.1, 0.1, yaw]));
  }

  // The eye of the next picture, in the scene.
  look(eye) {
    this.uniforms.uEye.value.copy(eye);
    this.sky.position.copy(eye);
    this.sky.scale.setScalar(40);
  }
}
