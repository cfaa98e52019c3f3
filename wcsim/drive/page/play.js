// The page of a film: what is heard is shown, what the person does goes to the player.

import { Grid, words } from "./grid.js";
import { Link } from "./link.js";
import { Scene } from "./scene.js";
import { big, by, counted, element, lamp, line, note, Numbers, put, waitFor, wireDialogs, wireDisplay } from "./shared.js";
import { Timeline } from "./timeline.js";

const LEAD_S = 3;
const CRASHES = ["crash", "drop"];
const LINES = { open: ["connected", "good"], lost: ["connection lost", "bad"] };
const ABSENT = { speed_mps: 0 };
const KPIS = [
  ["kpi1", "Stick difference (KPI 1)", (k) => (k.kpi1 === null ? "–" : k.kpi1.toFixed(3))],
  ["kpi2", "Steps per episode (KPI 2)", (k) => (k.kpi2 === null ? "–" : k.kpi2.toFixed(0))],
  ["ticks", "Steps driven", (k) => k.ticks], ["way", "Driven", (k) => `${k.way_m.toFixed(0)} m`],
  ["speed", "Speed", (k, c) => `${Math.abs(c.speed_mps).toFixed(2)} m/s`],
  ["step", "Step of this episode", (k, c) => c.step ?? "–"],
  ["left", "To go", (k, c) => (c.left_m === undefined ? "–" : `${c.left_m.toFixed(0)} m`)],
  ["crashes", "Crashes", (k) => k.crashes ?? "–"], ["drops", "Falls off a kerb", (k) => k.drops ?? "–"],
  ["arrivals", "Arrivals", (k) => k.arrivals ?? "–"], ["warnings", "Warnings", (k) => k.warnings ?? "–"],
  ["interventions", "Interventions", (k) => k.interventions ?? "–"],
];

let about = null;
let state = null;
let crash = "";
let dragging = false;
const numbers = new Numbers(KPIS);

function say(text) {
  by("spoken").textContent = by("spoken").textContent === text ? `${text} ` : text;
}

const link = new Link({
  line(what) {
    line(LINES[what]);
    say(LINES[what][0]);
    if (what === "open") scene.tell();
    else { waitFor(""); big("Connection lost. Trying again …"); }
  },
  pictures(number, parts) { scene.show(number, parts).catch((error) => console.warn(`a moment that cannot be shown: ${error}`)); },
  street(message) { scene.setStreet(message); },
  way(message) { scene.setWay(message); },
  about: tellAbout,
  busy(message) { waitFor(message.told, message.waits !== false); say(message.told); },
  notice(message) { note(message.kind, message.told, message.kind === "bad"); },
  marks(message) { timeline.setMarks(message.marks); choose(); },
  role(role) {
    by("banner").hidden = role.drives || !role.told;
    by("banner-text").textContent = role.taken ? "Another page controls the film. You are watching." : "No page controls the film.";
    document.body.dataset.drives = String(role.drives);
    if (role.drives) scene.tell();
  },
  state: tellState,
});

const scene = new Scene(link);
const grid = new Grid(by("stick"), null, "Joystick: the user’s stick and the chair’s command, described in words below.");
const timeline = new Timeline(by("marks"), by("at"), by("legend"), seek);

function seek(to) {
  link.say("seek", { to: Math.max(0, Math.round(to)) });
}

function choose() {
  timeline.choose(state ? state.seat : -1, by("all").checked);
}

function lead() {
  return by("lead").checked && about ? Math.round(LEAD_S / about.tick_s) : 0;
}

function jump(kinds, forward) {
  if (!state) return;
  const from = state.at + lead();
  const mark = forward ? timeline.next(kinds, from) : timeline.before(kinds, from);
  const name = kinds === CRASHES ? "crash" : "intervention";
  if (!mark) {
    const none = state.crash && kinds === CRASHES ? `This is the ${forward ? "last" : "first"} crash` : `There is no ${forward ? "later" : "earlier"} ${name}`;
    note("note", `${none}${state.reading ? " in the part read so far" : ""}.`);
    return;
  }
  if (mark[1] >= 0 && mark[1] !== state.seat) link.say("followseat", { seat: mark[1] });
  seek(mark[0] - lead());
}

function tellAbout(told) {
  about = { ...told.film, ...told };
  waitFor("");
  by("place").textContent = about.title;
  document.title = `${about.title} – wcsim film`;
  grid.setPoints(about.points);
  scene.setUnsafe([], about.points);
  by("legend-unsafe").hidden = !about.tells_unsafe;
  by("camera-figure").hidden = !about.camera;
  by("live").hidden = !about.live;
  by("unknown").replaceChildren(...(about.unknown.length ? about.unknown : ["Everything this page can show is in it."]).map((line) => element("li", line)));
  by("failed-part").hidden = !about.failed.length;
  by("failed").replaceChildren(...about.failed.map((one) => {
    const item = element("li");
    const button = element("button", `${one.block}.${one.seat} ${one.policy}: ${one.told}`, { type: "button" });
    button.addEventListener("click", () => (one.policy === about.policy && one.block === about.block
      ? link.say("followseat", { seat: one.seat }) : link.say("openepisode", { policy: one.policy, block: one.block, seat: one.seat })));
    item.append(button);
    return item;
  }));
  scene.tell();
}

function clock(ticks) {
  const seconds = ticks * about.tick_s;
  return `${Math.floor(seconds / 60)}:${(seconds % 60).toFixed(1).padStart(4, "0")}`;
}

function tellState(now) {
  const before = state;
  state = now;
  if (!about) return;
  const last = Math.max(now.count - 1, about.ticks - 1);
  timeline.setSpan(now.first, last);
  if (!dragging) by("at").value = String(now.at);
  by("at").setAttribute("aria-valuetext", `${clock(now.at)} of ${clock(last)}`);
  if (!before || before.seat !== now.seat) choose();
  const read = now.reading && about.ticks > now.count ? `, ${Math.floor(100 * now.count / about.ticks)} % loaded` : "";
  put(by("clock"), `${clock(now.at)} / ${clock(last)}${read} · world ${now.epoch}, step ${now.tick}`);
  put(by("told"), now.ended || now.told);
  put(by("play"), now.paused ? "Play" : "Pause");
  by("play").setAttribute("aria-pressed", String(!now.paused));
  by("live").setAttribute("aria-pressed", String(now.live));
  by("pace").value = String(now.pace);
  put(by("size"), `${counted(now.count - now.first, "step")}, ${now.size_mb} MB${now.first ? `; steps before ${clock(now.first)} were dropped` : ""}`);
  tellChair(now);
  tellChairs(now);
  document.body.dataset.at = String(now.at);
  document.body.dataset.count = String(now.count);
}

function tellChair(now) {
  const row = now.chairs.find(({ seat }) => seat === now.seat);
  const own = row?.chair ?? ABSENT; // what is false, or not known, is left out of it
  numbers.tell(...(row ? [row.kpis, own] : []));
  grid.show(own.unsafe);
  scene.setUnsafe(own.unsafe);
  grid.move(own.stick, own.commanded);
  const asked = own.stick ? `user: ${words(own.stick)}` : "user: not known";
  put(by("stick-text"), own.commanded ? `${asked} · chair: ${words(own.commanded)}` : asked);
  lamp("lamp-warning", Boolean(own.warning), about.warns ? (own.warning ? "danger ahead" : "none") : "not known");  // as in panel.js
  const follows = own.stick && own.commanded;
  lamp("lamp-intervening", Boolean(own.intervening), follows ? (own.intervening ? "corrects the stick" : "none") : "not known");
  lamp("lamp-crash", Boolean(now.crash), now.crash || (about.points.length ? "none" : "not known"));
  lamp("lamp-who", false, about.tells_who ? decides(own) : "not known");
  if (now.crash && now.crash !== crash) say(`The chair ${now.crash}.`);
  crash = now.crash;
  big(own !== ABSENT ? (now.crash ? `The chair ${now.crash}.` : "") : "This chair is not in the street at this moment.");
}

function decides(own) {
  if (own.alone) return "user alone";
  if (own.overruled) return "user overrules";
  return own.unaided ? "user, not assisted" : "policy";
}

function tellChairs(now) {
  const home = by("chairs");
  while (home.children.length > now.chairs.length) home.lastChild.remove();
  now.chairs.forEach(({ seat, name: told, chair, kpis: k }, index) => {
    if (!home.children[index]) home.append(chairButton());
    const button = home.children[index];
    button.dataset.seat = String(seat);
    button.dataset.here = String(Boolean(chair));
    button.setAttribute("aria-pressed", String(seat === now.seat));
    const [name, signs, more] = button.children;
    put(name, told);
    put(signs, !chair ? "not here" : chair.crashed ? "✕ crash" : chair.warning ? "▲ warning" : chair.intervening ? "▬ intervention" : "follows the user");
    put(more, `${counted(k.ticks, "step")} · KPI 1 ${k.kpi1 === null ? "–" : k.kpi1.toFixed(3)} · KPI 2 ${k.kpi2 === null ? "–" : k.kpi2.toFixed(0)} · ${k.crashes === null ? "– crashes" : counted(k.crashes, "crash", "crashes")}`);
  });
}

function chairButton() {
  const button = element("button", "", { type: "button" });
  button.append(element("b"), element("span", "", { className: "signs" }), element("span", "", { className: "more" }));
  button.addEventListener("click", () => link.say("followseat", { seat: Number(button.dataset.seat) }));
  return button;
}

function nextChair() {
  if (!state || !state.chairs.length) return;
  const at = state.chairs.findIndex(({ seat }) => seat === state.seat);
  link.say("followseat", { seat: state.chairs[(at + 1) % state.chairs.length].seat });
}

function changePace(by_) {
  const options = [...by("pace").options].map((option) => Number(option.value));
  const at = options.indexOf(Number(by("pace").value));
  link.say("pace", { times: options[Math.min(options.length - 1, Math.max(0, at + by_))] });
}

const step = (ticks) => link.say("stepby", { ticks });
const playOrPause = () => { if (state) link.say("pause", { on: !state.paused }); };
const click = (id, does) => by(id).addEventListener("click", does);
click("play", playOrPause);
click("back", () => step(-1));
click("on", () => step(1));
click("back-crash", () => jump(CRASHES, false));
click("on-crash", () => jump(CRASHES, true));
click("back-intervention", () => jump(["intervention"], false));
click("on-intervention", () => jump(["intervention"], true));
click("live", () => link.say("golive"));
click("take-over", () => link.say("takeover"));
by("pace").addEventListener("change", () => link.say("pace", { times: Number(by("pace").value) }));
by("all").addEventListener("change", choose);
for (const [event, on] of [["pointerdown", true], ["pointerup", false], ["pointercancel", false], ["blur", false]]) by("at").addEventListener(event, () => { dragging = on; });

const KEYS = {
  ArrowLeft: (event) => step(event.shiftKey ? -second() : -1),
  ArrowRight: (event) => step(event.shiftKey ? second() : 1),
  Home: () => seek(0),
  End: () => (about && about.live ? link.say("golive") : seek(state ? state.count - 1 : 0)),
};
const LETTERS = {
  KeyC: (event) => jump(CRASHES, !event.shiftKey),
  KeyV: (event) => jump(["intervention"], !event.shiftKey),
  KeyN: nextChair,
  BracketLeft: () => changePace(-1),
  BracketRight: () => changePace(1),
};

function second() {
  return about ? Math.round(1 / about.tick_s) : 10;
}

addEventListener("keydown", (event) => {
  if (document.querySelector("dialog[open]") || event.ctrlKey || event.metaKey || event.altKey) return;
  const node = event.target instanceof HTMLElement ? event.target : document.body;
  if (node.matches("select, input:not([type=checkbox]):not([type=range]), summary")) return;
  const takesSpace = node.matches("button, a, input[type=checkbox]");
  if (event.code === "Space" && !takesSpace) { playOrPause(); event.preventDefault(); return; }
  if (event.code in KEYS) { KEYS[event.code](event); event.preventDefault(); return; }
  const isLetter = event.code.startsWith("Key") || event.code.startsWith("Bracket");
  if (isLetter && !by("letters").checked) return;
  if (event.code in LETTERS) { if (!event.repeat) LETTERS[event.code](event); event.preventDefault(); return; }
  if (scene.key(event)) event.preventDefault();
});

wireDialogs();
wireDisplay(() => timeline.draw());
