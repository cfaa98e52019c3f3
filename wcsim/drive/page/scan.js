// Driving by one to four switches. One or two: choices are highlighted in turn, a press picks one, and the chair goes on
// with it until any press stops it. Three or four: a direction each, while held; left and right held together for a
// second show the other choices, of which 1 goes back, 3 on, and 2 picks.

import { element, wireHold } from "./shared.js";

const ACTS = [
  { name: "Ask for help", act: "help" }, { name: "Overrule", act: "overrule" }, { name: "Pause / resume", act: "pause" },
];
const CHOICES = [
  { name: "Ahead", stick: [0, 1] }, { name: "Slowly ahead", stick: [0, 0.5] },
  { name: "Ahead left", stick: [-0.25, 0.75] }, { name: "Ahead right", stick: [0.25, 0.75] },
  { name: "Turn left", stick: [-0.5, 0] }, { name: "Turn right", stick: [0.5, 0] },
  { name: "Back", stick: [0, -0.5] }, ...ACTS,
];
const MORE = [...ACTS, { name: "Back to driving", act: "" }];
const ELSEWHERE = [{ name: "Take control", act: "takeOver" }];
const HELD = { Digit1: [-0.5, 0], Digit2: [0, 1], Digit3: [0.5, 0], Digit4: [0, -0.5] };
const NAMES = { Digit1: "Left", Digit2: "Ahead", Digit3: "Right", Digit4: "Back" };
const MORE_MS = 1000;

export class Scan {
  constructor(home, stick, acts) {
    this.home = home;
    this.stick = stick;
    this.acts = acts; // help(), overrule(), pause(), takeOver(), say(text)
    this.switches = 0;
    this.seconds = 1.4;
    this.drives = this.mayTake = false;
    this.at = 0;
    this.driving = null;
    this.timer = 0;
    this.down = []; // of three or four: those that are held, the newest last
    this.more = false; // the other choices stand in the place of directions
    this.moreTimer = 0;
    this.overrules = false;
    this.buttons = [];
  }

  // What can be picked now; null while switches are directions.
  get choices() {
    if (!this.drives) return this.mayTake ? ELSEWHERE : [];
    if (this.switches < 3) return CHOICES;
    return this.more ? MORE : null;
  }

  set(switches) {
    this.switches = switches;
    this.render();
  }

  // Whether this page drives, and may if it does not.
  setRole(drives, mayTake) {
    if (drives === this.drives && mayTake === this.mayTake) return; // who drives goes on when another page comes
    this.drives = drives;
    this.mayTake = mayTake;
    this.render();
  }

  render(more = false) {
    this.more = more;
    const codes = Object.keys(HELD).slice(0, this.switches);
    this.buttons = this.switches === 0 ? [] : this.choices ? this.choices.map((each, index) => this.choiceButton(each, index)) : codes.map((code) => this.holdButton(code));
    this.home.hidden = this.buttons.length === 0;
    this.home.replaceChildren(...this.buttons);
    this.showOverrule(this.overrules);
    this.rest();
  }

  button(name) {
    return element("button", name, { type: "button", tabIndex: -1 });
  }

  holdButton(code) {
    const button = this.button(`${code.slice(-1)} ${NAMES[code]}`);
    wireHold(button, (down) => this.hold(code, down));
    return button;
  }

  choiceButton(choice, index) {
    const button = this.button(choice.name);
    button.addEventListener("click", () => { if (!this.halt()) { this.at = index; this.pick(); } });
    return button;
  }

  key(event, down) {
    if (this.switches === 0) return false;
    if (this.switches >= 3) return this.keyOfMany(event, down);
    if (event.code === "Tab" || event.metaKey || event.ctrlKey || event.altKey) return false;
    if (!down || event.repeat) return true;
    if (this.halt()) return true;
    if (this.switches === 2 && event.code !== "Enter") this.move(1); else this.pick();
    return true;
  }

  // A switch that repeats by itself is no new press: after a stop it counts only once it has been let go of.
  keyOfMany(event, down) {
    if (!(event.code in HELD) || Number(event.code.slice(-1)) > this.switches) return false;
    if (down && event.repeat) return true;
    if (!this.choices) this.hold(event.code, down);
    else if (down && event.code === "Digit2") this.pick();
    else if (down && event.code !== "Digit4") this.move(event.code === "Digit1" ? -1 : 1);
    return true;
  }

  hold(code, down) {
    this.down = this.down.filter((each) => each !== code);
    if (down) this.down.push(code);
    const both = this.down.includes("Digit1") && this.down.includes("Digit3");
    clearTimeout(this.moreTimer);
    if (both) this.moreTimer = setTimeout(() => this.render(true), MORE_MS);
    this.stick.latched = both || !this.down.length ? [0, 0] : HELD[this.down.at(-1)];
  }

  release(code) {
    if (this.down.includes(code)) this.hold(code, false);
  }

  // Any press while the chair goes stops it; whether it went.
  halt() {
    if (!this.driving) return false;
    this.rest();
    this.acts.say("Stopped.");
    return true;
  }

  rest() {
    this.driving = null;
    this.down = [];
    this.stick.latched = [0, 0];
    clearTimeout(this.moreTimer);
    clearInterval(this.timer);
    this.timer = this.switches === 1 ? setInterval(() => this.move(1), this.seconds * 1000) : 0;
    this.at = 0;
    this.highlight();
  }

  move(by) {
    const count = this.choices?.length ?? 0;
    if (this.driving || !count) return;
    this.at = (this.at + by + count) % count;
    this.highlight();
  }

  pick() {
    const choice = this.choices?.[this.at];
    if (!choice) return;
    if (choice.stick) {
      this.driving = choice;
      this.stick.latched = choice.stick;
      clearInterval(this.timer);
      this.acts.say(`${choice.name}. Any key stops.`);
    } else if (choice.act) this.acts[choice.act]();
    if (this.more) this.render(); else this.highlight();
  }

  highlight() {
    if (!this.choices) return;
    this.buttons.forEach((button, index) => {
      if (index === this.at) button.dataset.at = this.driving ? "drives" : "here"; else delete button.dataset.at;
    });
  }

  // Choices that would end badly now: the nearest position is unsafe.
  mark(unsafe, points) {
    const bad = new Set(unsafe);
    this.choices?.forEach((choice, index) => {
      if (!choice.stick || !this.buttons[index]) return;
      const gap = ([x, y]) => Math.hypot(x - choice.stick[0], y - choice.stick[1]);
      const nearest = points.reduce((best, point, number) => (best < 0 || gap(point) < gap(points[best]) ? number : best), -1);
      const told = bad.has(nearest) ? `${choice.name}: unsafe` : choice.name;
      if (this.buttons[index].textContent !== told) this.buttons[index].textContent = told;
      this.buttons[index].dataset.unsafe = String(bad.has(nearest));
    });
  }

  showOverrule(on) {
    this.overrules = on;
    const at = this.choices?.findIndex((each) => each.act === "overrule") ?? -1;
    if (this.buttons[at]) this.buttons[at].dataset.on = String(on);
  }
}
