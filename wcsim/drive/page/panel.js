// Lamps, numbers, and the controls of assistance, time and place.

import { words } from "./grid.js";
import { by, Numbers } from "./shared.js";

const KPIS = [
  ["kpi1", "KPI 1, distance", (k) => (k.kpi1 === null ? "–" : k.kpi1.toFixed(3))],
  ["kpi2", "KPI 2, steps", (k) => k.kpi2.toFixed(0)],
  ["speed", "Speed", (k, s) => `${Math.abs(s.speed_mps).toFixed(2)} m/s`],
  ["way", "Driven", (k) => `${k.way_m.toFixed(0)} m`],
  ["left", "To go", (k, s) => `${s.left_m.toFixed(0)} m`],
  ["time", "Time", (k) => `${Math.floor(k.time_s / 60)}:${String(Math.floor(k.time_s % 60)).padStart(2, "0")}`],
  ["arrivals", "Arrivals", (k) => k.arrivals], ["crashes", "Crashes", (k) => k.crashes],
  ["warnings", "Warnings", (k) => k.warnings], ["interventions", "Interventions", (k) => k.interventions],
  ["helps", "Help calls", (k) => k.helps], ["overrules", "Overruled", (k) => k.overrules],
];

export class Panel {
  constructor(link, say) {
    this.link = link;
    this.say = say;
    this.about = null;
    this.state = null;
    this.levels = null;
    this.numbers = new Numbers(KPIS);
    this.wire();
  }

  wire() {
    const on = (id, event, does) => by(id).addEventListener(event, does);
    on("assist", "click", () => this.link.say("assist", { on: !this.state?.assisted }));
    on("level", "input", () => { const level = this.levelOf(Number(by("level").value)); if (level !== null) this.link.say("setlevel", { level }); });
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
    const same = (names) => names.map((name) => [name, name.startsWith("recorded:") ? "recorded" : name]);
    const users = about.profiles.includes(about.profile) ? about.profiles : [about.profile, ...about.profiles];
    const towns = about.towns.includes(about.town) ? about.towns : [...about.towns, about.town];
    this.fill("user", same(users), about.profile);
    this.fill("town", same(towns), about.town);
    if (by("suite").options.length === 0) { this.fill("suite", same(Object.keys(about.suites)), "dev"); this.fillBlocks(); }
    this.levels = about.levels;
    by("level").disabled = !about.levels;
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

  lamp(id, on, text) {
    const lamp = by(id);
    const word = lamp.querySelector("span");
    if (lamp.dataset.on === String(on) && word.textContent === text) return false;
    lamp.dataset.on = String(on);
    word.textContent = text;
    return true;
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
    by("rate").textContent = state.rate ? `${state.rate.toFixed(1)} ticks/s` : "";
    this.tellLevel(state.level);
    const who = state.alone || state.driver === "simulated" ? "simulated user" : "you";
    const same = Math.hypot(state.stick[0] - state.commanded[0], state.stick[1] - state.commanded[1]) < 0.2;
    by("stick-text").textContent = same ? `${who}: ${words(state.stick)}` : `${who}: ${words(state.stick)} · chair: ${words(state.commanded)}`;
    document.body.dataset.tick = String(state.tick);
  }

  lamps(state, before) {
    if (this.lamp("lamp-warning", state.warning, state.warning ? "danger ahead" : "clear") && state.warning) this.say("Warning: danger ahead.");
    if (this.lamp("lamp-intervening", state.intervening, state.intervening ? "steers otherwise" : "follows the stick") && state.intervening) this.say("The assistance intervenes.");
    this.lamp("lamp-assist", state.assisted && !state.overruled, state.overruled ? "overruled" : state.assisted ? "on" : "off");
    if (before && before.assisted !== state.assisted) this.say(`Assistance ${state.assisted ? "on" : "off"}.`);
    const turn = state.bearing_deg;
    const side = Math.abs(turn) > 150 ? "behind you" : Math.abs(turn) < 20 ? "ahead" : `${Math.round(Math.abs(turn) / 10) * 10}° to the ${turn > 0 ? "left" : "right"}`;
    this.lamp("lamp-way", false, side);
    by("way-arrow").setAttribute("transform", `rotate(${-turn} 12 12)`);
  }

  tellLevel(level) {
    if (level === null || !this.levels) { by("level-text").textContent = "this policy has none"; return; }
    const [least, most] = this.levels;
    const share = Math.round(100 * (level - least) / (most - least));
    if (document.activeElement !== by("level")) by("level").value = String(share);
    const text = least > most ? `dangers up to ${level.toFixed(2)} are allowed` : level.toFixed(2);
    by("level-text").textContent = text;
    by("level").setAttribute("aria-valuetext", text);
  }
}

// The lamp that says whether this drive is kept, and where; what is to be said aloud of it, "" for nothing.
export function tellKeeping(message) {
  const lamp = by("keeping");
  const name = message.file.split("/").pop();
  const word = message.on ? "Recording" : "Not recording";
  const where = message.on ? (name ? `to ${name}` : "from the first tick on") : message.told || (name ? `${name} is whole` : "");
  const said = `${word} ${where}`;
  const before = lamp.hidden ? "" : lamp.textContent.trim().replace(/\s+/g, " ");
  lamp.hidden = false;
  lamp.dataset.on = String(message.on);
  lamp.title = message.file;
  lamp.querySelector("strong").textContent = word;
  lamp.querySelector(".where").textContent = where;
  return before === said ? "" : `${said}.`;
}
