// Lamps, numbers, and the controls of assistance, time and place.

import { words } from "./grid.js";
import { by, element, lamp, Numbers, put } from "./shared.js";

const KPIS = [
  ["speed", "Speed", (k, s) => `${Math.abs(s.speed_mps).toFixed(2)} m/s`],
  ["way", "Driven", (k) => `${k.way_m.toFixed(0)} m`],
  ["left", "To go", (k, s) => `${s.left_m.toFixed(0)} m`],
  ["time", "Time", (_, now) => `${Math.floor(now.time_s / 60)}:${String(Math.floor(now.time_s % 60)).padStart(2, "0")}`],
  ["arrivals", "Arrivals", (k) => k.arrivals], ["crashes", "Crashes", (k) => k.crashes],
  ["warnings", "Warnings", (k) => k.warnings], ["interventions", "Interventions", (k) => k.interventions],
  ["helps", "Calls for help", (k) => k.helps], ["overrules", "Overruled", (k) => k.overrules],
  ["kpi1", "Mean difference from your stick", (k) => (k.kpi1 === null ? "–" : k.kpi1.toFixed(3))],
  ["kpi2", "Mean steps without a crash", (k) => k.kpi2.toFixed(0)],
];

const FOLLOWS = 0.06; // farther, and the diamond is visibly beside the point: positions lie 0.25 apart
const STANDS_MPS = 0.05;
const CALM_MS = 1200; // so long without an intervention ends it
const TOLD_MS = 6000;

// What the chair does differently from the stick, in words.
export function deed(stick, commanded) {
  const [asked, given] = [Math.hypot(...stick), Math.hypot(...commanded)];
  if (given < 0.15) return "braked";
  if (asked < 0.15) return "moved while your stick was at rest";
  const told = [];
  if (stick[1] * commanded[1] < 0 && Math.min(Math.abs(stick[1]), Math.abs(commanded[1])) > 0.1) told.push(commanded[1] > 0 ? "went forward" : "went back");
  else if (Math.abs(commanded[1]) < Math.abs(stick[1]) - 0.12) told.push("slowed");
  else if (Math.abs(commanded[1]) > Math.abs(stick[1]) + 0.12) told.push("sped up");
  if (Math.abs(commanded[0] - stick[0]) > 0.12) told.push(commanded[0] > stick[0] ? "turned right" : "turned left");
  return told.join(", ") || "steered slightly differently";
}

// One intervention after another: several with short gaps are one, of which the farthest from the stick is told.
class Deeds {
  constructor() {
    this.now = ""; // of the intervention that goes on
    this.near = ""; // what was nearest in the way
    this.far = 0;
    this.last_ms = -1e9; // when a tick of it was
    this.done = "";
    this.until_ms = -1e9;
  }

  tell(state, now_ms) {
    const far = Math.hypot(state.stick[0] - state.commanded[0], state.stick[1] - state.commanded[1]);
    let begins = false, ended = "";
    if (state.crash || state.overruled) { this.now = this.done = ""; }
    if (state.intervening) {
      if (!this.now) { begins = true; this.far = 0; this.near = ""; }
      if (far > this.far) { this.far = far; this.now = deed(state.stick, state.commanded); }
      if (this.now === "braked" && Math.abs(state.speed_mps) < STANDS_MPS) this.now = "stopped";
      this.last_ms = now_ms;
    } else if (this.now && now_ms - this.last_ms > CALM_MS) {
      ended = this.done = this.now;
      this.now = "";
      this.until_ms = now_ms + TOLD_MS;
    }
    const idle = !state.assisted ? "assistance is off" : state.overruled ? "overruled" : far < FOLLOWS ? "none" : "slight correction";
    const lamp = state.intervening ? "corrects your stick" : idle;
    const done = this.now || (now_ms < this.until_ms ? this.done : "");
    if (this.now && state.near) this.near = state.near;
    const near_told = this.near ? ` Nearest in the way: ${this.near}.` : "";
    return { begins, ended, lamp, line: done ? `Assistance: ${done}${this.now ? " …" : "."}${near_told}` : "" };
  }
}

export class Panel {
  constructor(link, say) {
    this.link = link;
    this.say = say;
    this.about = null;
    this.state = null;
    this.levels = null;
    this.deeds = new Deeds();
    this.numbers = new Numbers(KPIS);
    this.wire();
  }

  wire() {
    const on = (id, event, does) => by(id).addEventListener(event, does);
    on("assist", "click", () => this.link.say("assist", { on: !this.state?.assisted }));
    on("level", "input", () => { const level = this.levelOf(Number(by("level").value)); if (level !== null) this.link.say("setlevel", { level }); });
    for (const id of ["stick-speed", "stick-sense"])
      on(id, "input", () => this.link.say("shapestick", { speed: by("stick-speed").value / 100, sensitivity: by("stick-sense").value / 100 }));
    on("driver", "change", () => this.link.say("driveby", { who: by("driver").value }));
    on("pause", "click", () => this.link.say("pause", { on: !this.state?.paused }));
    on("pace", "change", () => this.link.say("pace", { times: Number(by("pace").value) }));
    on("new-place", "click", () => this.link.say("newplace"));
    on("again", "click", () => this.link.say("again"));
    on("user", "change", () => this.link.say("setuser", { profile: by("user").value }));
    on("go-town", "click", () => this.link.say("open", { town: by("town").value, seed: this.seed() }));
    on("suite", "change", () => this.fillBlocks());
    on("block", "change", () => this.fillSeats());
    on("go-episode", "click", () => this.link.say("open", { suite: by("suite").value, block: Number(by("block").value), seat: Number(by("seat").value) }));
  }

  seed() {
    return Math.min(2147483647, Math.max(0, Math.floor(Number(by("seed").value)) || 0));
  }

  fill(id, items, chosen) {
    by(id).replaceChildren(...items.map(([value, text]) => { const option = new Option(text, value); option.selected = String(value) === String(chosen); return option; }));
  }

  tellAbout(about) {
    this.about = about;
    by("place").textContent = about.place;
    by("policy").textContent = about.policy;
    by("seed").value = String(about.seed);
    const same = (names) => names.map((name) => [name, name.startsWith("recorded:") ? "recorded" : name]);
    const users = about.profiles.includes(about.profile) ? about.profiles : [about.profile, ...about.profiles];
    const towns = about.towns.includes(about.town) ? about.towns : [...about.towns, about.town];
    this.fill("user", same(users), about.profile);
    this.fill("town", same(towns), about.town);
    if (by("suite").options.length === 0) { this.fill("suite", same(Object.keys(about.suites)), "dev2"); this.fillBlocks(); }
    this.levels = about.levels;
    this.tellOwn(about.own_level);
    by("legend-unsafe").hidden = !about.tells_unsafe;
  }

  fillBlocks() {
    const blocks = this.about?.suites[by("suite").value] ?? [];
    this.fill("block", blocks.map(([told], index) => [index, `${index}: ${told}`]), 0);
    this.fillSeats();
  }

  fillSeats() {
    const block = this.about?.suites[by("suite").value]?.[Number(by("block").value)];
    this.fill("seat", Array.from({ length: block ? block[1] : 0 }, (_, index) => [index, index]), 0);
  }

  levelOf(share) {
    if (!this.levels) return null;
    const [least, most] = this.levels;
    return Number((least + (most - least) * share / 100).toFixed(3));
  }

  shareOf(level) {
    const [least, most] = this.levels;
    return Math.round(100 * (level - least) / (most - least));
  }

  // The mark below the slider; a thumb's middle never comes nearer to the ends than 8 px.
  tellOwn(level) {
    by("own-level").hidden = level === null || !this.levels;
    if (by("own-level").hidden) return;
    const share = this.shareOf(level);
    const mark = by("own-level").firstElementChild;
    mark.textContent = "▲";
    mark.style.left = `calc(8px + (100% - 16px) * ${share / 100})`;
    by("own-level").replaceChildren(mark, element("b", `original: ${level.toFixed(2)}`));
    by("own-level").dataset.side = share >= 50 ? "left" : "right";
  }

  tellState(state) {
    const before = this.state;
    this.state = state;
    this.numbers.tell(state.kpis, state);
    this.lamps(state, before);
    by("assist").setAttribute("aria-checked", String(state.assisted));
    by("pause").setAttribute("aria-pressed", String(state.paused));
    by("driver").value = state.driver;
    by("pace").value = String(state.pace);
    by("user").value = state.profile;
    const slow = state.pace === 1 && state.real < 0.9 && !state.paused;
    put(by("rate"), slow ? `Slow motion: ${state.real.toFixed(1)} of real time` : "");
    this.tellLevel(state.level);
    ["stick-speed", "stick-sense"].forEach((id, place) => { if (document.activeElement !== by(id)) by(id).value = Math.round(100 * state.shape[place]); });
    by("level").disabled = !this.levels || !state.assisted;
    by("levels").dataset.on = String(state.assisted);
    const who = state.alone || state.driver === "simulated" ? "simulated user" : "you";
    put(by("legend-you"), who);
    put(this.numbers.cells.kpi1.previousSibling, `Mean difference from ${who === "you" ? "your" : "the user’s"} stick`);
    const same = Math.hypot(state.stick[0] - state.commanded[0], state.stick[1] - state.commanded[1]) < 0.2;
    by("stick-text").textContent = same ? `${who}: ${words(state.stick)}` : `${who}: ${words(state.stick)} · chair: ${words(state.commanded)}`;
    document.body.dataset.tick = String(state.tick);
  }

  lamps(state, before) {
    if (lamp("lamp-warning", state.warning, state.warning ? state.near || "danger" : "none") && state.warning && !before?.warning) this.say(`Warning: ${state.near || "danger"}.`);
    const told = this.deeds.tell(state, performance.now());
    if (lamp("lamp-intervening", state.intervening, told.lamp) && state.intervening && !before?.intervening && told.begins) this.say("The assistance intervenes.");
    if (told.ended) this.say(`The assistance ${told.ended}.`);
    put(by("did"), told.line);
    lamp("lamp-assist", state.assisted && !state.overruled, state.overruled ? "overruled" : !state.assisted ? "off" : state.help_s > 0 ? `helps for ${Math.ceil(state.help_s)} s` : "on");
    if (before && before.assisted !== state.assisted) this.say(`Assistance ${state.assisted ? "on" : "off"}.`);
    if (lamp("lamp-road", state.on_road, state.on_road ? "you are on the road" : "you are not on it") && state.on_road) this.say("You are on the road.");
    const turn = state.bearing_deg;
    const side = Math.abs(turn) > 150 ? "behind you" : Math.abs(turn) < 20 ? "ahead" : `${Math.round(Math.abs(turn) / 10) * 10}° to the ${turn > 0 ? "left" : "right"}`;
    lamp("lamp-way", false, side);
    by("way-arrow").setAttribute("transform", `rotate(${-turn} 12 12)`);
  }

  tellLevel(level) {
    if (level === null || !this.levels) { by("level-text").textContent = "fixed for this policy"; return; }
    const [least, most] = this.levels;
    const share = this.shareOf(level);
    if (document.activeElement !== by("level")) by("level").value = String(share);
    const acts = share > 66 ? "acts early" : share < 34 ? "acts late" : "medium";
    const text = least > most ? `${acts}: when danger exceeds ${level.toFixed(2)}` : `${acts}: ${level.toFixed(2)}`;
    by("level-text").textContent = text;
    by("level").setAttribute("aria-valuetext", text);
  }
}

// The lamp that says whether this drive is kept, and where; what is to be said aloud of it, "" for nothing.
export function tellKeeping(message) {
  const sign = by("keeping");
  const name = message.file.split("/").pop();
  const word = message.on ? "Recording" : "Not recording";
  const where = message.on ? (name ? `to ${name}` : "starts when you drive") : message.told || (name ? `${name} is complete` : "");
  const said = `${word} ${where}`;
  const before = sign.hidden ? "" : sign.textContent.trim().replace(/\s+/g, " ");
  sign.hidden = false;
  sign.dataset.on = String(message.on);
  sign.title = message.file;
  sign.querySelector("strong").textContent = word;
  sign.querySelector(".where").textContent = where;
  return before === said ? "" : `${said}.`;
}

// What to do first, over the picture, till the person has set out; aloud once a start.
const SET_OUT_M = 1;
const GONE_M = 6; // whoever has driven so far against the way knows what they do
const BEHIND_DEG = 110;
const SWITCHES = ["", "Pick “Ahead” with your switch", "Pick “Ahead” with Enter", "Hold 2", "Hold 2"];

export class Hint {
  constructor(say) {
    this.say = say;
    this.begin();
  }

  begin() {
    this.from_m = null;
    this.done = false;
    this.said = new Set();
    this.show("");
  }

  tell(state, may, switches) {
    const driven_m = state.kpis.way_m;
    if (this.from_m === null) this.from_m = driven_m;
    const away_m = driven_m - this.from_m;
    const behind = Math.abs(state.bearing_deg) > BEHIND_DEG;
    if (away_m > GONE_M || (away_m > SET_OUT_M && !behind)) this.done = true;
    const mine = may && state.driver === "person" && !state.alone && !state.crash && !state.let_go;
    const drives = Math.abs(state.speed_mps) > STANDS_MPS && !behind;
    if (this.done || !mine || drives || state.warning || state.intervening) { this.show(""); return; }
    if (behind) { this.show("The route is behind you: turn left or right first."); return; }
    const push = matchMedia("(pointer: coarse)").matches ? "Push the disc ahead" : "Press ↑ (up arrow), or push the disc";
    this.show(`${switches ? SWITCHES[switches] : push}; follow the green dots.`);
  }

  show(text) {
    by("hint").hidden = !text;
    put(by("hint"), text);
    if (!text || this.said.has(text)) return;
    this.said.add(text);
    this.say(text);
  }
}
