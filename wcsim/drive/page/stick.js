// Where the person's stick is: keys, pointer and gamepad together, the one that is pushed farthest counts.

const DEAD_ZONE = 0.15;
const LET_GO = 0.05; // a stick within this has been let go of
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

function farthest(sticks) {
  return sticks.reduce((best, each) => (Math.hypot(...each) > Math.hypot(...best) ? each : best), REST);
}

// Those that are there, each with its place and name.
function pads() {
  const all = navigator.getGamepads ? [...navigator.getGamepads()] : [];
  const named = all.map((each, place) => [`${place} ${each?.id}`, each]);
  return named.filter(([, each]) => each && each.connected !== false && each.axes.length >= 2);
}

export class Stick {
  constructor(tell) {
    this.tell = tell; // hears of gamepads that come and go, and of every loss
    this.held = new Set();
    this.half = false;
    this.pointer = REST;
    this.holder = null; // the pointer that pushes the disc, by its number
    this.latched = REST; // of switches
    this.stopped = false; // until everything has been let go of
    this.padsSeen = []; // places and names of all gamepads
    this.padsRested = new Set(); // of those that have been at rest since they came
    this.buttons = new Set(); // of gamepads, that are down
    this.away = document.hidden;
    addEventListener("blur", () => this.leave());
    addEventListener("focus", () => { this.away = document.hidden; });
    document.addEventListener("visibilitychange", () => { if (document.hidden) this.leave(); else this.away = false; });
    addEventListener("gamepaddisconnected", () => this.lose());
  }

  // A key that repeats by itself is no new press: it has been held since before a stop, or since the page was left.
  key(event, down) {
    if (!(event.code in ARROWS)) return false;
    if (!down) this.held.delete(event.code);
    else if (!event.repeat) this.held.add(event.code);
    this.half = event.shiftKey;
    return true;
  }

  // What is held stays held, and counts for nothing before all of it has been let go of.
  stop() {
    this.latched = REST;
    this.stopped = true;
  }

  // Nobody will tell of the keys that are released from now on, so none is held any more.
  forget() {
    this.held.clear();
    this.stop();
  }

  leave() {
    this.away = true;
    this.holder = null;
    this.pointer = REST;
    this.forget();
    this.tell("left");
  }

  lose() {
    this.padsSeen = pads().map(([name]) => name); // of those that are left nobody says that they have come
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

  // The buttons of gamepads that have gone down since the last call, by their numbers in the standard layout.
  pressed() {
    const down = new Set(pads().flatMap(([name, pad]) => pad.buttons.flatMap((button, number) => (button.pressed ? [`${name} ${number}`] : []))));
    const fresh = [...down].filter((each) => !this.buttons.has(each)).map((each) => Number(each.split(" ").at(-1)));
    this.buttons = down;
    return this.away ? [] : fresh;
  }

  // Of several gamepads the one that is pushed farthest. One counts once it has been at rest: pedals rest at their ends.
  fromPads() {
    const found = pads();
    const names = found.map(([name]) => name);
    const before = this.padsSeen;
    if (before.some((name) => !names.includes(name))) this.lose();
    else if (names.length > before.length) { this.padsSeen = names; this.tell("plugged", found.map(([, pad]) => pad.id).join(", ")); }
    this.padsRested = new Set(names.filter((name) => this.padsRested.has(name)));
    const sticks = found.map(([name, pad]) => [name, pastDeadZone(pad.axes[0], -pad.axes[1])]);
    for (const [name, stick] of sticks) if (stick === REST) this.padsRested.add(name);
    return farthest(sticks.filter(([name]) => this.padsRested.has(name)).map(([, stick]) => stick));
  }

  // What is held, the switches aside, which a stop lets go of.
  pushed() {
    return farthest([this.pointer, this.fromKeys(), this.fromPads()]);
  }

  raw() {
    return farthest([this.latched, this.pushed()]);
  }

  now() {
    const pushed = this.pushed();
    if (this.away) return REST;
    if (this.stopped && (this.held.size > 0 || Math.hypot(...pushed) >= LET_GO)) return REST; // two keys may cancel out
    this.stopped = false;
    return farthest([this.latched, pushed]);
  }
}
