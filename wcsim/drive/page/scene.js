// The pictures, and the camera that the person turns around the chair.

import { by, element } from "./shared.js";

const HOME = { turn_rad: 0, tilt_rad: 0.38, distance_m: 6 };
const STEP = { left: [-0.25, 0, 1], right: [0.25, 0, 1], up: [0, 0.12, 1], down: [0, -0.12, 1], in: [0, 0, 0.85], out: [0, 0, 1.18] };
const VIEWS = {
  left: ["⟲", "Turn the view left"], right: ["⟳", "Turn the view right"], up: ["▲", "View from higher"], down: ["▼", "View from lower"],
  in: ["+", "Nearer"], out: ["−", "Farther"], home: ["⌂", "View from behind again"],
};
const KEYS = { KeyJ: "left", KeyL: "right", KeyI: "up", KeyK: "down", Equal: "in", NumpadAdd: "in", BracketRight: "in", Minus: "out", NumpadSubtract: "out", Slash: "out", Digit0: "home" };
const MOST_PX = 960;

export class Scene {
  constructor(link) {
    this.link = link;
    this.orbit = { ...HOME };
    this.canvases = { S: by("scene"), C: by("camera"), M: by("chart") };
    this.shown = 0;
    const scene = this.canvases.S;
    this.drag(scene);
    scene.addEventListener("wheel", (event) => { event.preventDefault(); this.zoom(Math.exp(event.deltaY / 600)); }, { passive: false });
    for (const [name, [sign, told]] of Object.entries(VIEWS)) {
      const button = element("button", sign, { type: "button" });
      button.setAttribute("aria-label", told);
      button.addEventListener("click", () => this.step(name));
      by("view").append(button);
    }
    by("camera-kind").addEventListener("change", () => this.tell());
    by("chart-on").addEventListener("change", () => this.tell());
    new ResizeObserver(() => this.tell()).observe(scene);
  }

  drag(scene) {
    const fingers = new Map();
    scene.addEventListener("pointerdown", (event) => { scene.setPointerCapture(event.pointerId); fingers.set(event.pointerId, [event.clientX, event.clientY]); });
    scene.addEventListener("pointermove", (event) => {
      const before = fingers.get(event.pointerId);
      if (!before) return;
      const span = () => { const [a, b] = [...fingers.values()]; return Math.hypot(a[0] - b[0], a[1] - b[1]); };
      const wide = fingers.size === 2 ? span() : 0;
      fingers.set(event.pointerId, [event.clientX, event.clientY]);
      if (fingers.size === 2) { this.zoom(wide / Math.max(1, span())); return; }
      this.turn((before[0] - event.clientX) * 0.008, (event.clientY - before[1]) * 0.006);
    });
    for (const end of ["pointerup", "pointercancel"]) scene.addEventListener(end, (event) => fingers.delete(event.pointerId));
  }

  key(event) {
    if (!(event.code in KEYS)) return false;
    this.step(KEYS[event.code]);
    return true;
  }

  step(name) {
    if (name === "home") { this.orbit = { ...HOME }; this.tell(); return; }
    const [turn, tilt, zoom] = STEP[name];
    this.orbit.distance_m *= zoom;
    this.turn(turn, tilt);
  }

  turn(turn, tilt) {
    this.orbit.turn_rad = (this.orbit.turn_rad + turn) % (2 * Math.PI);
    this.orbit.tilt_rad = Math.min(1.53, Math.max(0.07, this.orbit.tilt_rad + tilt));
    this.tell();
  }

  zoom(times) {
    this.orbit.distance_m *= times;
    this.tell();
  }

  tell() {
    this.orbit.distance_m = Math.min(40, Math.max(2, this.orbit.distance_m));
    const box = this.canvases.S.getBoundingClientRect();
    const scale = Math.min(devicePixelRatio || 1, MOST_PX / Math.max(1, box.width));
    const size = (length) => Math.round(Math.min(1280, Math.max(160, length * scale)));
    this.link.say("setview", {
      ...this.orbit, width_px: size(box.width), height_px: size(box.height),
      camera: by("camera-kind").value, chart: by("chart-on").checked,
    });
  }

  async show(number, parts) {
    for (const [letter, blob] of Object.entries(parts)) {
      const canvas = this.canvases[letter];
      const picture = await createImageBitmap(blob);
      if (canvas.width !== picture.width || canvas.height !== picture.height) { canvas.width = picture.width; canvas.height = picture.height; }
      canvas.getContext("2d").drawImage(picture, 0, 0);
      picture.close();
    }
    this.shown += 1;
    document.body.dataset.pictures = String(this.shown);
    this.link.say("shown", { number });
  }
}
