// Driving by one to four switches. One or two: choices are highlighted in turn, a press picks one, and the chair goes on
// with it until any press stops it. Three or four: a direction each, while held.

const CHOICES = [
  { name: "Ahead", stick: [0, 1] }, { name: "Slowly ahead", stick: [0, 0.5] },
  { name: "Ahead left", stick: [-0.25, 0.75] }, { name: "Ahead right", stick: [0.25, 0.75] },
  { name: "Turn left", stick: [-0.5, 0] }, { name: "Turn right", stick: [0.5, 0] },
  { name: "Back", stick: [0, -0.5] }, { name: "Ask for help", act: "help" }, { name: "Overrule", act: "overrule" },
];
const HELD = { Digit1: [-0.5, 0], Digit2: [0, 1], Digit3: [0.5, 0], Digit4: [0, -0.5] };
const NAMES = { Digit1: "Left", Digit2: "Ahead", Digit3: "Right", Digit4: "Back" };

export class Scan {
  constructor(home, stick, acts) {
    this.home = home;
    this.stick = stick;
    this.acts = acts; // help(), overrule() -> whether it is on now, say(text)
    this.switches = 0;
    this.seconds = 1.4;
    this.at = 0;
    this.driving = null;
    this.timer = 0;
  }

  set(switches) {
    this.switches = switches;
    this.rest();
    this.home.hidden = switches === 0;
    this.home.replaceChildren();
    const names = switches >= 3 ? Object.keys(HELD).slice(0, switches).map((code) => NAMES[code]) : CHOICES.map((each) => each.name);
    this.buttons = switches === 0 ? [] : names.map((name, index) => this.button(name, index));
    this.home.append(...this.buttons);
    this.highlight();
  }

  button(name, index) {
    const button = document.createElement("button");
    button.type = "button";
    button.tabIndex = -1;
    button.textContent = this.switches >= 3 ? `${index + 1} ${name}` : name;
    if (this.switches >= 3) {
      const code = `Digit${index + 1}`;
      button.addEventListener("pointerdown", () => this.hold(code, true));
      for (const end of ["pointerup", "pointerleave", "pointercancel"]) button.addEventListener(end, () => this.hold(code, false));
    } else {
      button.addEventListener("click", () => { if (!this.halt()) { this.at = index; this.pick(); } });
    }
    return button;
  }

  key(event, down) {
    if (this.switches === 0) return false;
    if (this.switches >= 3) {
      if (!(event.code in HELD) || Number(event.code.slice(-1)) > this.switches) return false;
      this.hold(event.code, down);
      return true;
    }
    if (event.code === "Tab" || event.metaKey || event.ctrlKey || event.altKey) return false;
    if (!down || event.repeat) return true;
    if (this.halt()) return true;
    if (this.switches === 2 && event.code !== "Enter") this.next(); else this.pick();
    return true;
  }

  hold(code, down) {
    this.stick.stopped = false;
    this.stick.latched = down ? HELD[code] : [0, 0];
  }

  release(code) {
    if (this.switches >= 3 && code in HELD) this.stick.latched = [0, 0];
  }

  // Any press while the chair goes stops it; whether it went.
  halt() {
    if (!this.driving) return false;
    this.rest();
    this.acts.say("Stopped.");
    this.highlight();
    return true;
  }

  rest() {
    this.driving = null;
    this.stick.latched = [0, 0];
    clearInterval(this.timer);
    this.timer = this.switches === 1 ? setInterval(() => this.next(), this.seconds * 1000) : 0;
    this.at = 0;
  }

  next() {
    if (this.driving) return;
    this.at = (this.at + 1) % CHOICES.length;
    this.highlight();
  }

  pick() {
    const choice = CHOICES[this.at];
    if (choice.act === "help") this.acts.help();
    else if (choice.act === "overrule") this.buttons[this.at].dataset.on = String(this.acts.overrule());
    else {
      this.driving = choice;
      this.stick.stopped = false;
      this.stick.latched = choice.stick;
      clearInterval(this.timer);
      this.acts.say(`${choice.name}. Any key stops.`);
    }
    this.highlight();
  }

  highlight() {
    if (this.switches >= 3) return;
    this.buttons?.forEach((button, index) => {
      if (index === this.at) button.dataset.at = this.driving ? "drives" : "here"; else delete button.dataset.at;
    });
  }
}
