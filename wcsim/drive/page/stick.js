// Where the person's stick is: keys, pointer and gamepad together, the one that is pushed farthest counts.

const DEAD_ZONE = 0.15;
const ARROWS = {
  ArrowUp: [0, 1], KeyW: [0, 1], ArrowDown: [0, -1], KeyS: [0, -1],
  ArrowLeft: [-1, 0], KeyA: [-1, 0], ArrowRight: [1, 0], KeyD: [1, 0],
};
export const REST = [0, 0];

export function inGate([x, y]) {
  const far = Math.hypot(x, y);
  return far > 1 ? [x / far, y / far] : [x, y];
}

export function pastDeadZone(x, y) {
  const far = Math.min(1, Math.hypot(x, y));
  if (far < DEAD_ZONE) return REST;
  const out = (far - DEAD_ZONE) / (1 - DEAD_ZONE) / far;
  return inGate([x * out, y * out]);
}

export class Stick {
  constructor(tell) {
    this.tell = tell; // hears of gamepads that come and go, and of every loss
    this.held = new Set();
    this.half = false;
    this.pointer = REST;
    this.latched = REST; // of scanning
    this.stopped = false; // until everything has been let go of
    this.padSeen = false;
    this.away = document.hidden;
    addEventListener("blur", () => this.leave());
    addEventListener("focus", () => { this.away = document.hidden; });
    document.addEventListener("visibilitychange", () => { if (document.hidden) this.leave(); else this.away = false; });
    addEventListener("gamepaddisconnected", () => this.lose());
  }

  key(event, down) {
    if (!(event.code in ARROWS)) return false;
    if (down) this.held.add(event.code); else this.held.delete(event.code);
    this.half = event.shiftKey;
    return true;
  }

  letGo() {
    this.held.clear();
    this.pointer = REST;
    this.latched = REST;
  }

  stop() {
    this.letGo();
    this.stopped = true;
  }

  leave() {
    this.away = true;
    this.stop();
    this.tell("left");
  }

  lose() {
    this.padSeen = false;
    this.stop();
    this.tell("unplugged");
  }

  fromKeys() {
    let [x, y] = REST;
    for (const code of this.held) { x += ARROWS[code][0]; y += ARROWS[code][1]; }
    const share = this.half ? 0.5 : 1;
    const [a, b] = inGate([Math.sign(x), Math.sign(y)]);
    return [a * share, b * share];
  }

  fromPad() {
    const pads = navigator.getGamepads ? [...navigator.getGamepads()] : [];
    const pad = pads.find((each) => each && each.connected !== false && each.axes.length >= 2);
    if (!pad) {
      if (this.padSeen) this.lose();
      return REST;
    }
    if (!this.padSeen) { this.padSeen = true; this.tell("plugged", pad.id); }
    return pastDeadZone(pad.axes[0], -pad.axes[1]);
  }

  raw() {
    const all = [this.latched, this.pointer, this.fromKeys(), this.fromPad()];
    return all.reduce((best, each) => (Math.hypot(...each) > Math.hypot(...best) ? each : best), REST);
  }

  now() {
    const farthest = this.raw();
    if (this.away) return REST;
    if (this.stopped) {
      if (Math.hypot(...farthest) < 0.05) this.stopped = false;
      return REST;
    }
    return farthest;
  }
}
