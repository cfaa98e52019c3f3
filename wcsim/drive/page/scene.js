// The street on the page: a camera that a person turns around the chair, a mirror, a map; all at the screen's rate.

import { OrthographicCamera, PerspectiveCamera, Raycaster, Vector3, WebGLRenderer } from "./three.js";
import { by, element, put } from "./shared.js";
import { between, betweenAngles, isLamp, isWalker, RANGE_M, Street3D, tickOf } from "./street.js";

const HOME = { turn_rad: 0, tilt_rad: 0.38, distance_m: 6 };
const STEP = { left: [-0.25, 0, 1], right: [0.25, 0, 1], up: [0, 0.12, 1], down: [0, -0.12, 1], in: [0, 0, 0.85], out: [0, 0, 1.18] };
const VIEWS = {
  left: ["⟲", "Turn the view left"], right: ["⟳", "Turn the view right"], up: ["▲", "View from higher"], down: ["▼", "View from lower"],
  in: ["+", "Nearer"], out: ["−", "Farther"], home: ["⌂", "View from behind again"], eyes: ["◉", "Through the chair’s eyes, or from behind"],
};
const KEYS = {
  KeyJ: "left", KeyL: "right", KeyI: "up", KeyK: "down", Equal: "in", NumpadAdd: "in", BracketRight: "in", Minus: "out", NumpadSubtract: "out", Slash: "out",
  Digit0: "home", KeyG: "eyes",
};
const AIM_M = 0.9; // above the ground: the middle of who sits in the chair
const AHEAD_SHARE = 0.35; // of the distance: the camera aims so far ahead of the chair while it looks from behind
const TURN_LAG_S = 0.5, ARM_LAG_S = 0.3; // the camera comes after a turn so slowly, which spares the stomach
const FIELD_DEG = 54; // of the picture's shorter side
const TILTS_RAD = [0, 0.21, 0.42, 0.63, 0.84, 1.05, 1.26];
const MARGIN_M = 0.3, ROOM_M = 3.5, LEAST_M = 1.2, HIGHEST_RAD = 1.53;
const DOT_EVERY_M = 0.9, DOTS_M = 30;
const TRACK_S = 2, TRACK_STEPS = 20;
const MAP_SPAN_M = 60, MAP_PX = 320, MAP_MS = 400;
const MIRROR_SHARE = 0.3, MIRROR_DEG = 62;
const TAGGED_M = 25, MOST_TAGS = 3;
const LEGEND_EVERY = 5, MOST_CLASSES = 8;
const SOFTWARE_QUALITY = 0.6;
const SLOW_MS = 85, FAST_MS = 34, CALM_FRAMES = 12;
const CHAIR = 7; // its template
const PUSHED = 0.15; // a stick that is pushed less leads nowhere
const NEAR_M = 1.6; // so near is what was hit
const HALF_M = 0.6, WAY_M = 4, WAY_STEP_M = 0.25, KERB_M = 0.025, WALL_M = 0.4;

// Whether the processor draws, which takes four times as long with smooth edges: there is no graphics card, or it is not used.
function isSoftware() {
  const gl = document.createElement("canvas").getContext("webgl2"), told = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl?.getParameter(told ? told.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|softpipe|software|basic render/i.test(name);
}

const isPlace = (place) => Array.isArray(place) && place.length === 3 && place.every(Number.isFinite);

export class Scene {
  constructor(link) {
    this.link = link;
    this.orbit = { ...HOME };
    this.eyes = false;
    this.ticks = []; // the two newest, { ...tick, at_ms }
    this.every_ms = 100;
    this.number = -1; // of the street
    this.yaw = 0;
    this.tilt = 0; // more than asked, for a wall is in the way
    this.share = 1; // of the distance that was asked
    this.quality = 1;
    this.slow = this.fast = 0;
    this.shown = 0;
    this.dirty = true;
    this.unsafe = [];
    this.points = [];
    this.cast = null; // the tick for which rays were cast last: what is in the way, and whose tag is hidden
    this.best = { tilt: 0, room: 1e3 };
    this.tagged = [];
    this.sharp = false;
    this.decodes = false; // a picture of the camera; those that come meanwhile are left out
    this.canvas = by("scene");
    this.start();
    this.wire();
  }

  start() {
    try {
      const slow = isSoftware();
      if (slow) this.quality = SOFTWARE_QUALITY;
      this.renderer = new WebGLRenderer({ canvas: this.canvas, antialias: !slow, powerPreference: "high-performance" });
    } catch {
      this.renderer = null;
      put(by("no-street"), "This browser cannot draw the street: it has no WebGL 2. Below is what the chair’s camera sees.");
      by("no-street").hidden = false;
      if (by("camera-kind").value === "nothing") by("camera-kind").value = "classes";
      return;
    }
    this.renderer.autoClear = false;
    this.street = new Street3D();
    this.camera = new PerspectiveCamera(FIELD_DEG, 16 / 9, 0.08, 1.5 * RANGE_M);
    this.mirror = new PerspectiveCamera(MIRROR_DEG, 3, 0.08, RANGE_M);
    this.above = new OrthographicCamera(-0.5 * MAP_SPAN_M, 0.5 * MAP_SPAN_M, 0.5 * MAP_SPAN_M, -0.5 * MAP_SPAN_M, 1, 400);
    for (const camera of [this.camera, this.mirror, this.above]) camera.up.set(0, 0, 1);
    this.above.up.set(0, 1, 0);
    this.ray = new Raycaster();
    this.canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    this.canvas.addEventListener("webglcontextrestored", () => { this.dirty = true; });
    const turn = (now_ms) => { this.frame(now_ms); requestAnimationFrame(turn); };
    requestAnimationFrame(turn);
  }

  wire() {
    this.drag(this.canvas);
    this.canvas.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY / 600)); }, { passive: false });
    for (const [name, [sign, told]] of Object.entries(VIEWS)) {
      const button = element("button", sign, { type: "button" });
      button.setAttribute("aria-label", told);
      button.addEventListener("click", () => this.step(name));
      by("view").append(button);
    }
    by("camera-kind").addEventListener("change", () => this.tell());
    for (const id of ["chart-on", "mirror-on"]) by(id)?.addEventListener("change", () => { this.dirty = true; });
    new ResizeObserver(() => { this.dirty = true; }).observe(this.canvas);
  }

  drag(node) {
    const fingers = new Map();
    node.addEventListener("pointerdown", (event) => { node.setPointerCapture(event.pointerId); fingers.set(event.pointerId, [event.clientX, event.clientY]); });
    node.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const span = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
      const wide = fingers.size === 2 ? span() : 0;
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      if (fingers.size === 2) { this.zoom(wide / Math.max(1, span())); return; }
      this.turn((before[0] - event.clientX) * 0.008, (event.clientY - before[1]) * 0.006);
    });
    for (const end of ["pointerup", "pointercancel"]) node.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }

  key(event) {
    if (!(event.code in KEYS)) return false;
    this.step(KEYS[event.code]);
    return true;
  }

  step(name) {
    this.dirty = true;
    if (name === "eyes") { this.eyes = !this.eyes; return; }
    if (name === "home") { this.orbit = { ...HOME }; this.eyes = false; return; }
    const [turn, tilt, zoom] = STEP[name];
    this.orbit.distance_m *= zoom;
    this.turn(turn, tilt);
  }

  turn(turn, tilt) {
    this.orbit.turn_rad = (this.orbit.turn_rad + turn) % (2 * Math.PI);
    this.orbit.tilt_rad = Math.min(HIGHEST_RAD, Math.max(0.07, this.orbit.tilt_rad + tilt));
    this.zoom(1);
  }

  zoom(times) {
    this.orbit.distance_m = Math.min(40, Math.max(2, this.orbit.distance_m * times));
    this.dirty = true;
  }

  tell() {
    this.link.say("setview", { camera: by("camera-kind").value });
  }

  // --- what is heard ---

  // A street, and the tiles that are near by now.
  async setStreet(told) {
    if (!isPlace(told.from) || !Array.isArray(told.tiles) || !Array.isArray(told.names) || typeof told.classes !== "object") { console.warn("a street that is none"); return; }
    this.eye = told.eye;
    this.names = told.names;
    this.classes = told.classes;
    if (!this.street) return;
    if (told.number !== this.number) {
      this.number = told.number;
      this.street.clear(told.from);
      this.ticks = [];
      this.way = null;
      if (!this.street.models) await this.load(told.models, (buffer) => this.street.addModels(buffer));
    }
    for (const name of this.street.tiles.keys()) if (!told.tiles.includes(name)) this.street.drop(name);
    await Promise.all(told.tiles.filter((name) => !this.street.tiles.has(name)).map((name) => {
      this.street.tiles.set(name, null);
      return this.load(name, (buffer) => { if (this.street.tiles.has(name)) this.street.addTile(name, buffer); });
    }));
    document.body.dataset.tiles = String([...this.street.tiles.values()].filter(Boolean).length);
  }

  async load(name, does) {
    try {
      const answer = await fetch(`street/${encodeURIComponent(name)}${location.search}`);
      if (!answer.ok) throw new Error(String(answer.status));
      does(await answer.arrayBuffer());
    } catch (error) {
      console.warn(`a part of the street is missing: ${name}: ${error}`);
      this.street.tiles.delete(name);
    }
    this.dirty = true;
  }

  setWay(told) {
    if (!Array.isArray(told.points) || !told.points.every(isPlace)) { console.warn("a way that is none"); return; }
    this.way = told.points.length ? told.points : null;
    this.arcs = [0];
    for (let i = 1; i < told.points.length; i++) this.arcs.push(this.arcs[i - 1] + Math.hypot(told.points[i][0] - told.points[i - 1][0], told.points[i][1] - told.points[i - 1][1]));
  }

  // What the policy holds for unsafe: numbers of `points`.
  setUnsafe(unsafe, points) {
    this.unsafe = unsafe ?? [];
    this.points = points ?? this.points;
  }

  // Said to be shown as soon as it is heard: the street is drawn at the screen's rate, whatever comes.
  async show(number, parts) {
    this.shown += 1;
    document.body.dataset.pictures = String(this.shown);
    this.link.say("shown", { number });
    if (parts.P) {
      const tick = { ...tickOf(parts.P), at_ms: performance.now() };
      const before = this.ticks.at(-1);
      if (before && !tick.jumped) this.every_ms += 0.1 * (Math.min(400, Math.max(30, tick.at_ms - before.at_ms)) - this.every_ms);
      if (!before || tick.jumped) { this.yaw = tick.yaw; this.share = 1; this.tilt = 0; }
      this.ticks = before && !tick.jumped ? [before, tick] : [tick, tick];
    }
    if (parts.C && !this.decodes) {
      this.decodes = true;
      const picture = await createImageBitmap(new Blob([parts.C], { type: "image/png" })).finally(() => { this.decodes = false; }), canvas = by("camera");
      if (canvas.width !== picture.width || canvas.height !== picture.height) { canvas.width = picture.width; canvas.height = picture.height; }
      const pen = canvas.getContext("2d", { willReadFrequently: true });
      pen.drawImage(picture, 0, 0);
      picture.close();
      if (this.shown % LEGEND_EVERY === 1) this.tellClasses(pen.getImageData(0, 0, canvas.width, canvas.height).data);
    }
  }

  // Which classes the camera's picture has, the largest first.
  tellClasses(rgba) {
    const counts = new Map();
    for (let at = 0; at < rgba.length; at += 4) {
      const colour = `#${((rgba[at] << 16) | (rgba[at + 1] << 8) | rgba[at + 2]).toString(16).padStart(6, "0")}`;
      counts.set(colour, (counts.get(colour) ?? 0) + 1);
    }
    const most = by("camera-kind").value === "classes" ? [...counts].filter(([colour]) => colour in this.classes).sort((a, b) => b[1] - a[1]) : [];
    by("camera-legend").replaceChildren(...most.slice(0, MOST_CLASSES).map(([colour]) => {
      const item = element("li", this.classes[colour]);
      item.style.setProperty("--colour", colour);
      return item;
    }));
  }

  // --- a frame ---

  frame(now_ms) {
    const dt_ms = Math.min(1000, now_ms - (this.last_ms ?? now_ms));
    const [before, after] = this.ticks;
    const moves = after && now_ms - after.at_ms < 2000;
    const idle = !this.dirty && !moves;
    if (!after || !this.street.models || document.hidden || (idle && this.sharp)) { this.last_ms = now_ms; return; }
    this.sharp = idle; // where nothing moves, one picture is as fine as the screen
    const casts = this.dirty || after !== this.cast;
    this.cast = after;
    this.dirty = false;
    this.last_ms = now_ms;
    if (!idle) this.measure(dt_ms);
    const share = after.jumped ? 1 : Math.min(1.2, Math.max(0, (now_ms - after.at_ms) / this.every_ms));
    const chair = this.chairAt(before, after, share);
    const dt_s = dt_ms / 1000;
    this.yaw = betweenAngles(this.yaw, chair.yaw, 1 - Math.exp(-dt_s / TURN_LAG_S));
    const rows = this.rowsAt(before, after, share);
    this.street.place(rows);
    this.size();
    const map_due = by("chart-on").checked && now_ms - (this.map_ms ?? -1e9) > MAP_MS;
    if (map_due) { this.map_ms = now_ms; this.drawMap(chair); }
    this.aim(chair, dt_s, casts);
    this.lay(chair);
    this.draw(chair);
    if (casts) this.tagged = this.toTag(chair, rows);
    this.tag(chair, rows);
    document.body.dataset.frames = String(Number(document.body.dataset.frames ?? 0) + 1);
  }

  // Pictures that come too slowly are made smaller, first of all.
  measure(dt_ms) {
    this.slow = dt_ms > SLOW_MS ? this.slow + 1 : 0;
    this.fast = dt_ms < FAST_MS ? this.fast + 1 : 0;
    if (this.slow > 4 && this.quality > 0.3) { this.quality *= 0.8; this.slow = 0; }
    if (this.fast > 10 * CALM_FRAMES && this.quality < 1) { this.quality = Math.min(1, this.quality * 1.15); this.fast = 0; }
    this.street.uniforms.uFine.value = this.quality > 0.6 ? 1 : 0;
    document.body.dataset.quality = this.quality.toFixed(2);
  }

  chairAt(a, b, share) {
    const at = (key) => between(a[key], b[key], share), turned = (key) => betweenAngles(a[key], b[key], share);
    const p = a.p.map((value, axis) => between(value, b.p[axis], share));
    return { p, yaw: turned("yaw"), pitch: turned("pitch"), roll: turned("roll"), speed: at("speed"), turn: at("turn"), done: at("done") };
  }

  rowsAt(a, b, share) {
    const rows = [];
    for (const [id, row] of b.rows) {
      if (this.eyes && row.template === CHAIR && Math.hypot(row.p[0] - b.p[0], row.p[1] - b.p[1]) < 0.8) continue;
      const from = a.rows.get(id);
      if (!from || from === row || Math.hypot(row.p[0] - from.p[0], row.p[1] - from.p[1]) > 6) { rows.push(row); continue; }
      rows.push({ ...row, p: row.p.map((value, axis) => between(from.p[axis], value, share)), yaw: betweenAngles(from.yaw, row.yaw, share), pitch: between(from.pitch, row.pitch, share) });
    }
    return rows;
  }

  size() {
    const box = this.canvas.getBoundingClientRect();
    const scale = Math.min(devicePixelRatio || 1, 2) * (this.sharp ? 1 : this.quality);
    const [width, height] = [Math.max(160, Math.round(box.width * scale)), Math.max(90, Math.round(box.height * scale))];
    if (this.canvas.width !== width || this.canvas.height !== height) this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    const field = (FIELD_DEG * Math.PI) / 180;
    this.camera.fov = this.camera.aspect >= 1 ? FIELD_DEG : (2 * Math.atan(Math.tan(field / 2) / this.camera.aspect) * 180) / Math.PI;
    if (this.eyes && this.eye) this.camera.fov = (2 * Math.atan(Math.tan((this.eye.hfov_deg * Math.PI) / 360) / this.camera.aspect) * 180) / Math.PI;
    this.camera.updateProjectionMatrix();
  }

  local(p) { return new Vector3(p[0] - this.street.from[0], p[1] - this.street.from[1], p[2] - this.street.from[2]); }

  // Where the camera stands, around the chair, so far from it and so high.
  stand(here, tilt, distance) {
    const from = this.yaw + Math.PI - this.orbit.turn_rad, flat = distance * Math.cos(tilt);
    return new Vector3(here.x + flat * Math.cos(from), here.y + flat * Math.sin(from), here.z + AIM_M + distance * Math.sin(tilt));
  }

  aim(chair, dt_s, casts) {
    const here = this.local(chair.p);
    if (this.eyes && this.eye) {
      const c = Math.cos(chair.yaw), s = Math.sin(chair.yaw), [x, y, z] = this.eye.p_m, yaw = chair.yaw + this.eye.yaw_rad, tilt = this.eye.pitch_rad + chair.pitch;
      this.camera.position.set(here.x + c * x - s * y, here.y + s * x + c * y, here.z + z + x * Math.sin(chair.pitch));
      this.camera.lookAt(this.camera.position.x + Math.cos(yaw) * Math.cos(tilt), this.camera.position.y + Math.sin(yaw) * Math.cos(tilt), this.camera.position.z + Math.sin(tilt));
      return;
    }
    // As near as can be to what was asked: higher, or nearer, where a wall is in the way.
    if (casts) this.best = this.freest(here);
    const part = 1 - Math.exp(-dt_s / ARM_LAG_S);
    this.tilt += part * (this.best.tilt - this.tilt);
    this.share += part * (Math.min(1, Math.max(this.best.room, LEAST_M) / this.orbit.distance_m) - this.share);
    const tilt = Math.min(this.orbit.tilt_rad + this.tilt, HIGHEST_RAD), distance = this.orbit.distance_m * this.share;
    const ahead = AHEAD_SHARE * distance * Math.cos(tilt) * Math.max(0, Math.cos(this.orbit.turn_rad));
    this.camera.position.copy(this.stand(here, tilt, distance));
    this.camera.lookAt(here.x + ahead * Math.cos(this.yaw), here.y + ahead * Math.sin(this.yaw), here.z + AIM_M);
  }

  // How much higher the camera should stand, and how far away it can.
  freest(here) {
    let best = { tilt: 0, room: -1 };
    for (const tilt of TILTS_RAD) {
      const room = this.room(here, Math.min(this.orbit.tilt_rad + tilt, HIGHEST_RAD));
      if (room > best.room + MARGIN_M) best = { tilt, room };
      if (best.room >= Math.min(this.orbit.distance_m, ROOM_M)) break;
    }
    return best;
  }

  room(here, tilt) {
    const aim = new Vector3(here.x, here.y, here.z + AIM_M), way = this.stand(here, tilt, 1).sub(aim).normalize();
    this.ray.set(aim, way);
    this.ray.far = this.orbit.distance_m + 1;
    const met = this.ray.intersectObjects(this.street.walls(), false)[0];
    return met ? met.distance - MARGIN_M : this.ray.far;
  }

  // Route, track and forbidden positions, on the ground.
  lay(chair) {
    const [cx, cy, cz] = chair.p;
    // 1. The route: dots on a raster along it, so that they lie still while the chair drives.
    const dots = [];
    if (this.way) {
      let i = 0;
      for (let arc = Math.ceil((chair.done + 1.2) / DOT_EVERY_M) * DOT_EVERY_M; arc < Math.min(chair.done + DOTS_M, this.arcs.at(-1)); arc += DOT_EVERY_M) {
        while (i < this.arcs.length - 2 && this.arcs[i + 1] < arc) i += 1;
        const share = (arc - this.arcs[i]) / Math.max(1e-6, this.arcs[i + 1] - this.arcs[i]);
        dots.push(this.way[i].map((value, axis) => between(value, this.way[i + 1][axis], share)));
      }
    }
    this.street.showWay(dots, this.way?.at(-1), this.camera.position);
    // 2. Where the chair goes on, at its speed and turn rate of now.
    const path = this.path(chair, chair.speed, chair.turn), half = 0.33;
    const corners = [], lift = cz + 0.04, side = ([x, y, yaw], left) => [x - left * Math.sin(yaw), y + left * Math.cos(yaw), lift];
    const band = (one, other, left, wide) => { const [a, b, c, d] = [side(one, left), side(one, left + wide), side(other, left + wide), side(other, left)]; corners.push(a, b, c, a, c, d); };
    const drives = Math.hypot(chair.speed, chair.turn) > 0.1;
    for (let i = 1; drives && i < path.length; i++) for (const left of [half, -half - 0.03]) band(path[i - 1], path[i], left, 0.03);
    if (drives) band([path.at(-1)[0] - 0.04 * Math.cos(path.at(-1)[2]), path.at(-1)[1] - 0.04 * Math.sin(path.at(-1)[2]), path.at(-1)[2]], path.at(-1), -half, 2 * half);
    this.street.showTrack(this.eyes ? [] : corners);
    // 3. Where the policy would not let it go.
    const crosses = this.unsafe.map((number) => {
      const [x, y] = this.points[number] ?? [0, 0], reach = 1.2 + 0.9 * Math.hypot(x, y), yaw = chair.yaw - Math.atan2(x, Math.abs(y) + 1e-6) * Math.sign(y || 1) + (y < 0 ? Math.PI : 0);
      return [cx + reach * Math.cos(yaw), cy + reach * Math.sin(yaw), lift, chair.yaw];
    });
    this.street.showCrosses(this.eyes ? [] : crosses);
  }

  path(chair, speed, turn) {
    const places = [[chair.p[0], chair.p[1], chair.yaw]], dt = TRACK_S / TRACK_STEPS;
    for (let i = 0; i < TRACK_STEPS; i++) {
      const [x, y, yaw] = places.at(-1), middle = yaw + 0.5 * turn * dt;
      places.push([x + speed * dt * Math.cos(middle), y + speed * dt * Math.sin(middle), yaw + turn * dt]);
    }
    return places;
  }

  draw(chair) {
    const { renderer, street } = this, { width, height } = this.canvas;
    this.camera.updateMatrixWorld();
    street.look(this.camera.position);
    renderer.setScissorTest(false);
    renderer.setViewport(0, 0, width, height);
    renderer.clear();
    renderer.render(street.scene, this.camera);
    if (this.eyes || !by("mirror-on")?.checked) return;
    // The mirror: from the chair's back, the sides changed.
    const wide = Math.round(MIRROR_SHARE * width), high = Math.round(wide / 3), left = Math.round(0.5 * (width - wide)), low = height - high - Math.round(0.015 * height);
    const here = this.local(chair.p), c = Math.cos(chair.yaw), s = Math.sin(chair.yaw);
    this.mirror.position.set(here.x - 0.5 * c, here.y - 0.5 * s, here.z + 1.35);
    this.mirror.lookAt(here.x - 6 * c, here.y - 6 * s, here.z + 0.4);
    this.mirror.updateProjectionMatrix();
    this.mirror.projectionMatrix.elements[0] *= -1; // a mirror changes the sides, and so which side of a face is seen
    street.street.side = street.marks.side = street.actor.side = 1;
    street.look(this.mirror.position);
    renderer.setScissorTest(true);
    const rim = Math.max(1, Math.round(0.003 * width));
    renderer.setScissor(left - rim, low - rim, wide + 2 * rim, high + 2 * rim);
    renderer.clear(); // black: its frame
    renderer.setScissor(left, low, wide, high);
    renderer.setViewport(left, low, wide, high);
    renderer.render(street.scene, this.mirror);
    street.street.side = street.marks.side = street.actor.side = 0;
    renderer.setScissorTest(false);
  }

  // The same street from straight above, north up; who moves is a mark large enough to be seen.
  drawMap(chair) {
    const { renderer, street } = this, here = this.local(chair.p), px = Math.min(MAP_PX, this.canvas.width, this.canvas.height);
    this.above.position.set(here.x, here.y, here.z + 200);
    this.above.lookAt(here.x, here.y, here.z);
    this.above.updateMatrixWorld();
    const dots = street.dots.mesh.visible;
    street.dots.mesh.visible = street.track.visible = street.crosses.mesh.visible = street.sky.visible = false;
    street.look(here);
    renderer.setViewport(0, 0, px, px);
    renderer.setScissorTest(true);
    renderer.setScissor(0, 0, px, px);
    renderer.clear();
    renderer.render(street.scene, this.above);
    renderer.setScissorTest(false);
    street.dots.mesh.visible = dots;
    street.crosses.mesh.visible = street.sky.visible = true;
    const chart = by("chart"), pen = chart.getContext("2d");
    pen.drawImage(this.canvas, 0, this.canvas.height - px, px, px, 0, 0, chart.width, chart.height);
    const scale = chart.width / MAP_SPAN_M, at = ([x, y]) => [chart.width / 2 + (x - chair.p[0]) * scale, chart.height / 2 - (y - chair.p[1]) * scale];
    this.markMap(pen, chart, chair, at);
  }

  markMap(pen, chart, chair, at) {
    if (this.way) {
      for (const [colour, wide] of [["#fff", 6], ["#00482a", 3]]) {
        pen.strokeStyle = colour; pen.lineWidth = wide; pen.lineJoin = "round";
        pen.beginPath(); this.way.forEach((point) => pen.lineTo(...at(point))); pen.stroke();
      }
    }
    for (const row of this.ticks[1].rows.values()) {
      if (this.isFixed(row, this.ticks[1].p)) continue;
      pen.beginPath(); pen.arc(...at(row.p), isWalker(row) ? 4 : 3.5, 0, 7);
      pen.fillStyle = isWalker(row) ? "#d62846" : "#2456be"; pen.fill();
      pen.lineWidth = 1.5; pen.strokeStyle = "#fff"; pen.stroke();
    }
    const mark = (x, y, angle, shape, colour) => {
      pen.save(); pen.translate(x, y); pen.rotate(angle); pen.beginPath(); shape.forEach((point) => pen.lineTo(...point)); pen.closePath();
      pen.fillStyle = colour; pen.fill(); pen.lineWidth = 2; pen.strokeStyle = "#fff"; pen.stroke(); pen.restore();
    };
    if (this.way) {
      const half = chart.width / 2, [x, y] = at(this.way.at(-1)), far = Math.max(Math.abs(x - half), Math.abs(y - half)), reach = half - 12;
      if (far <= reach) mark(x, y, 0, [[0, 0], [0, -18], [13, -13], [1, -8]], "#c41e3a");
      else mark(half + (x - half) * reach / far, half + (y - half) * reach / far, Math.atan2(y - half, x - half), [[9, 0], [-6, 7], [-6, -7]], "#c41e3a");
    }
    mark(chart.width / 2, chart.height / 2, -chair.yaw, [[12, 0], [-8, 8], [-4, 0], [-8, -8]], "#105cb8");
  }

  // Who is near ahead and in sight, the nearest first; no label lies upon another.
  toTag(chair, rows) {
    const tags = [], gapOf = (row) => Math.hypot(row.p[0] - chair.p[0], row.p[1] - chair.p[1]);
    for (const row of [...rows].sort((a, b) => gapOf(a) - gapOf(b))) {
      if (gapOf(row) > TAGGED_M || tags.length === MOST_TAGS) break;
      const ahead = (row.p[0] - chair.p[0]) * Math.cos(chair.yaw) + (row.p[1] - chair.p[1]) * Math.sin(chair.yaw);
      if (ahead <= 0 || this.isFixed(row, chair.p)) continue;
      const [u, v] = this.tagAt(row);
      if (u === null || tags.some(([, a, b]) => Math.abs(a - u) < 120 && Math.abs(b - v) < 22) || this.hidden(this.topOf(row))) continue;
      tags.push([row.id, u, v]);
    }
    return tags.map(([id]) => id);
  }

  topOf(row) {
    const top = this.local(row.p);
    top.z += row.size[2] + 0.12;
    return top;
  }

  // Where a label stands, in pixels of the page; nulls outside of the picture.
  tagAt(row) {
    const seen = this.topOf(row).project(this.camera), { clientWidth: width, clientHeight: height } = this.canvas;
    return seen.z > 1 || Math.abs(seen.x) > 1 || Math.abs(seen.y) > 1 ? [null, null] : [(0.5 + 0.5 * seen.x) * width, (0.5 - 0.5 * seen.y) * height];
  }

  tag(chair, rows) {
    const home = by("tags"), { clientWidth: width, clientHeight: height } = this.canvas;
    const tags = rows.filter((row) => this.tagged.includes(row.id)).map((row) => [...this.tagAt(row), `${this.names?.[row.template] ?? "somebody"} ${Math.hypot(row.p[0] - chair.p[0], row.p[1] - chair.p[1]).toFixed(0)} m`]).filter(([u]) => u !== null);
    while (home.children.length < MOST_TAGS + 1) home.append(element("span"));
    [...home.children].forEach((node, i) => {
      if (i === MOST_TAGS) return;
      node.hidden = i >= tags.length;
      if (node.hidden) return;
      put(node, tags[i][2]);
      node.style.transform = `translate(${tags[i][0].toFixed(1)}px, ${tags[i][1].toFixed(1)}px) translate(-50%, -100%)`;
    });
    const speed = home.children[MOST_TAGS], end = this.path(chair, chair.speed, chair.turn).at(-1), place = this.local([end[0], end[1], chair.p[2]]).project(this.camera);
    speed.hidden = this.eyes || Math.abs(chair.speed) < 0.1 || place.z > 1 || Math.abs(place.x) > 1;
    if (!speed.hidden) { put(speed, `${Math.abs(chair.speed).toFixed(1)} m/s`); speed.style.transform = `translate(${((0.5 + 0.5 * place.x) * width + 46).toFixed(1)}px, ${((0.5 - 0.5 * place.y) * height).toFixed(1)}px)`; }
  }

  // What is nearest where the stick leads, how far and on which side, in words; "" for nothing. A policy does not say why.
  inTheWay([x, y]) {
    const tick = this.ticks[1];
    if (!this.street || !tick || Math.hypot(x, y) < PUSHED) return "";
    const { p, yaw } = tick, heading = yaw - Math.atan2(x, y), [c, s] = [Math.cos(heading), Math.sin(heading)], found = [];
    for (const row of tick.rows.values()) {
      const gap = [row.p[0] - p[0], row.p[1] - p[1]], far = Math.hypot(...gap), free = far - HALF_M - 0.5 * Math.min(row.size[0], row.size[1]);
      if (!this.isFixed(row, p) && free < WAY_M && gap[0] * c + gap[1] * s > 0.5 * far) found.push([Math.max(0, free), this.names[row.template], row.p]);
    }
    let before = this.heightAt(p[0], p[1], p[2]);
    for (let far = HALF_M; far < HALF_M + WAY_M; far += WAY_STEP_M) {
      const place = [p[0] + far * c, p[1] + far * s, p[2]], height = this.heightAt(...place), rise = height - before;
      const kind = height - p[2] > WALL_M ? "wall" : rise > KERB_M ? "kerb" : rise < -KERB_M ? "drop" : "";
      if (kind) { found.push([far - HALF_M, kind, place]); break; }
      before = height;
    }
    if (!found.length) return "";
    const [away, kind, place] = found.sort((a, b) => a[0] - b[0])[0];
    return `${kind} ${away.toFixed(1)} m ${this.sideOf(place)}`;
  }

  // Where a place is, for who sits in the chair.
  sideOf(place) {
    const { p, yaw } = this.ticks[1], from = betweenAngles(0, Math.atan2(place[1] - p[1], place[0] - p[0]) - yaw, 1), side = from > 0 ? "left" : "right";
    if (Math.abs(from) < 0.35) return "in front of you";
    return Math.abs(from) > 2.36 ? "behind you" : Math.abs(from) < 0.79 ? `ahead on your ${side}` : `on your ${side}`;
  }

  // On which side it is what was hit, of a crash in words: the nearest road user or wall; "" for ground and kerbs.
  touched(words) {
    const tick = this.ticks[1];
    if (!this.street || !tick || /ground|kerb|shaken|tipped|fell/.test(words)) return "";
    const { p } = tick, gap = (row) => Math.hypot(row.p[0] - p[0], row.p[1] - p[1]) - 0.5 * Math.min(row.size[0], row.size[1]);
    const others = [...tick.rows.values()].filter((row) => !this.isFixed(row, p)).sort((a, b) => gap(a) - gap(b));
    if (others.length && gap(others[0]) < NEAR_M) return ` ${this.sideOf(others[0].p)}`;
    let best = null;
    for (let turn = 0; turn < 2 * Math.PI; turn += 0.2) {
      this.ray.set(this.local([p[0], p[1], p[2] + 0.5]), new Vector3(Math.cos(turn), Math.sin(turn), 0));
      this.ray.far = NEAR_M;
      const met = this.ray.intersectObjects(this.street.walls(), false)[0];
      if (met && (!best || met.distance < best.distance)) best = met;
    }
    return best ? ` ${this.sideOf([best.point.x + this.street.from[0], best.point.y + this.street.from[1]])}` : "";
  }

  // The chair itself, and lamps.
  isFixed(row, p) { return (row.template === CHAIR && Math.hypot(row.p[0] - p[0], row.p[1] - p[1]) < 0.8) || isLamp(row); }

  // The height of what is met from a metre above a place in W downwards; that place's where nothing is.
  heightAt(x, y, z) {
    this.ray.set(this.local([x, y, z + 1.2]), new Vector3(0, 0, -1));
    this.ray.far = 3;
    const met = this.ray.intersectObjects(this.street.walls(), false)[0];
    return met ? met.point.z + this.street.from[2] : z;
  }

  hidden(place) {
    const way = place.clone().sub(this.camera.position), far = way.length();
    this.ray.set(this.camera.position, way.normalize());
    this.ray.far = far - 0.5;
    return this.ray.intersectObjects(this.street.walls(), false).length > 0;
  }
}
