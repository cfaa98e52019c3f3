// The page: what is heard goes to the panel, what the person does goes to the server, 30 times a second.

import { Grid } from "./grid.js";
import { Link } from "./link.js";
import { Hint, Panel, tellKeeping } from "./panel.js";
import { Scan } from "./scan.js";
import { Scene } from "./scene.js";
import { big, by, keep, kept, line, note, put, sound, waitFor, wireDialogs, wireDisplay, wireHold } from "./shared.js";
import { Stick } from "./stick.js";
import { Study } from "./study.js";

const SEND_MS = 33;
const SAID_MS = 5000;
const TAP_MS = 350, TAPPED_MS = 20_000; // a press that is shorter goes on for so long
const PAD = { 0: () => askForHelp(), 1: () => tapOverrule(), 9: () => by("pause").click() }; // A, B, start
const LINES = { open: ["connected", "good"], lost: ["connection lost: the chair stops", "bad"] };

let drives = false;
let overrules = false;
let pressed_ms = 0; // when the press began that overrules
let tapTimer = 0;
let ended = false; // by this press, what a brief one began
let busy = "";
let lastSaid = "";
let crash = "";
let warned = false;
let hit = null; // of the crash that is shown
let speed_mps = 0; // of the state before
let standing = ""; // why the chair does not go
let sayTimer = 0;

// Told to a screen reader, and gone before somebody reads the page and takes it for what is so now.
function say(text) {
  if (text === lastSaid) by("live").textContent = "";
  lastSaid = text;
  by("live").textContent = text;
  clearTimeout(sayTimer);
  sayTimer = setTimeout(() => { by("live").textContent = ""; }, SAID_MS);
}

function overrule(on) {
  const isNew = on !== overrules;
  overrules = on;
  by("overrule").setAttribute("aria-pressed", String(on));
  scan.showOverrule(on);
  clearInterval(tapTimer);
  tapTimer = 0;
  put(by("overrule-told"), "Overrule");
  if (isNew && on) pressed_ms = performance.now();
  if (isNew) send(); // at once: the shortest press is over before the next stick is said
}

// What is pressed briefly overrules for some seconds, and pressed again ends that; what is held, while it is.
function pressOverrule() {
  ended = tapTimer !== 0;
  overrule(!ended);
}

function releaseOverrule() {
  if (overrules && !tapTimer && !ended && performance.now() - pressed_ms < TAP_MS) tapOverrule(true);
  else if (!tapTimer) overrule(false);
}

function tapOverrule(begins = !overrules) {
  overrule(begins);
  if (!begins) return;
  const until_ms = performance.now() + TAPPED_MS;
  const tell = () => {
    const left_s = Math.ceil((until_ms - performance.now()) / 1000);
    if (left_s <= 0) { overrule(false); say("Overruling is over."); } else put(by("overrule-told"), `Overrules for ${left_s} s`);
  };
  tapTimer = setInterval(tell, 250);
  tell();
}

const stick = new Stick((what, name) => {
  if (what === "plugged") { by("pad").textContent = `Gamepad: ${name}`; say("Gamepad connected."); }
  if (what === "unplugged") { by("pad").textContent = "Gamepad unplugged. The chair stops."; say("Gamepad unplugged. The chair stops."); }
  if (what !== "plugged") { overrule(false); scan.rest(); }
  send();
});

const link = new Link({
  line(what) {
    line(LINES[what]);
    say(LINES[what][0]);
    if (what === "open") { scene.tell(); by("place").textContent = "opening the street …"; }
    else { setBusy(""); setRole({ drives: false, taken: false, told: "" }); big("Connection lost. The chair stops. Trying again …"); }
  },
  pictures(number, parts) { scene.show(number, parts).catch((error) => console.warn(`a moment that cannot be shown: ${error}`)); },
  street(message) { scene.setStreet(message); },
  way(message) { scene.setWay(message); },
  about(about) { setBusy(""); scene.setUnsafe([], about.points); panel.tellAbout(about); grid.setPoints(about.points); hint.begin(); big(""); },
  busy(message) { if (!busy || message.waits === false) say(message.told); setBusy(message.told, message.waits !== false); rest(); },
  study(message) { study.tell(message.view); },
  notice(message) { note(message.kind, message.told); study.notice(message.told); if (message.kind === "bad" && busy) { setBusy(message.told, false); } },
  role: setRole,
  keeping(message) { const told = tellKeeping(message); if (told) say(told); },
  state(state) {
    const near = state.warning || state.intervening ? scene.inTheWay(state.stick) : "";
    panel.tellState({ ...state, near });
    grid.show(state.unsafe);
    scene.setUnsafe(state.unsafe);
    grid.move(state.stick, state.commanded);
    scan.mark(state.unsafe, grid.points);
    if (state.crash && state.crash !== crash) { say(crashed(state)); sound(90, 0.4); }
    if (state.warning && !warned) sound(880, 0.18);
    warned = state.warning;
    if (crash && !state.crash) hint.begin();
    const told = state.crash ? crashed(state) : "";
    crash = state.crash;
    speed_mps = state.speed_mps;
    if (state.crash || (state.let_go && scan.driving)) rest();
    tellStanding(state);
    hint.tell(state, drives && !busy && !standing, Number(by("steer-by").value) || 0);
    by("big").dataset.crash = String(Boolean(state.crash));
    big(busy || (told || standing || (state.alone ? "The simulated user drives until the handover" : "")));
  },
});

const scene = new Scene(link);
const grid = new Grid(by("stick"), stick);
const panel = new Panel(link, say);
const hint = new Hint(say);
const scan = new Scan(by("board"), stick, {
  help: askForHelp, overrule: () => tapOverrule(), pause: () => by("pause").click(), takeOver: () => by("take-over").click(), say,
});

const study = new Study(link, { say, stop: stopNow, switches: () => Number(by("steer-by").value) || 0, seconds: () => scan.seconds, meet });

function setRole(role) {
  drives = role.drives;
  by("banner").hidden = role.drives || !role.told;
  by("banner-text").textContent = role.told;
  document.body.dataset.drives = String(role.drives);
  if (role.told) say(role.told);
  scan.setRole(drives, Boolean(role.told));
  if (!drives) { rest(); overrule(false); } else scene.tell();
  study.setRole(drives);
}

// Words over the street are no live region, so why the chair does not go is said as it changes.
function tellStanding(state) {
  const before = standing;
  const holds = drives && !state.crash && (state.let_go || stick.stopped); // of a crash something else is said
  const pushed = holds && state.driver === "person" && Math.hypot(...stick.raw()) > 0.1;
  standing = state.waiting || (state.paused ? "Paused" : state.tick === 0 ? "Getting ready …" : pushed ? "Release the stick first." : "");
  if (standing === before) return;
  if (standing) say(standing);
  else if (before === "Paused") say("Resumed.");
}

// What was hit, on which side and how fast: at the touch, so the speed is that of the tick before.
function crashed(state) {
  if (!crash) hit = { side: scene.touched(state.crash), mps: Math.abs(speed_mps) };
  const words = state.crash.replace(/^drove into /, "hit ").replace("was hit", "were hit").replace("was shaken", "were shaken");
  return `You ${words}${hit.side} at ${hit.mps.toFixed(1)} m/s. You start again a little before that place.`;
}

function setBusy(told, counts) {
  busy = told;
  waitFor(busy, counts);
}

function askForHelp() {
  const why = !link.there ? "the connection is lost" : !drives ? "this page only watches" : busy ? "the street is not open" : "";
  if (!why) { link.say("help"); say("You asked for help."); return; }
  note("bad", `Help was not sent: ${why}.`);
  say(`Help was not sent: ${why}.`);
}

function rest() {
  stick.stop();
  scan.rest();
}

function stopNow() {
  rest();
  send();
}

function send() {
  const [x, y] = stick.now();
  if (drives) for (const number of stick.pressed()) PAD[number]?.();
  if (drives) link.say("stick", { x, y, overrule: overrules, away: stick.away });
}

setInterval(send, SEND_MS);

by("stop").addEventListener("click", stopNow);
by("stop").addEventListener("pointerdown", stopNow);
by("help").addEventListener("click", askForHelp);
by("take-over").addEventListener("click", () => link.say("takeover"));
wireHold(by("overrule"), (on, event) => {
  if (on) { by("overrule").setPointerCapture(event.pointerId); pressOverrule(); } else releaseOverrule();
});
by("overrule").addEventListener("blur", () => overrule(false));
// A screen reader presses without a pointer or a key, and cannot hold.
by("overrule").addEventListener("click", (event) => { if (event.detail === 0) tapOverrule(); });

const LETTERS = {
  KeyH: (down) => { if (down) askForHelp(); },
  KeyO: (down) => { if (down) pressOverrule(); },
  KeyE: (down) => { if (down) by("assist").click(); },
  KeyP: (down) => { if (down) by("pause").click(); },
};

function isField(node) {
  return node instanceof HTMLElement && node.matches("select, input:not([type=checkbox]), summary");
}

const HOLDS = ["Space", "Enter"];
const isOverrule = (event) => event.target === by("overrule") && HOLDS.includes(event.code);

// Whatever has the focus and whatever else is pressed: a release that is not seen would keep the stick pushed.
function release(event) {
  stick.key(event, false);
  scan.release(event.code);
  if (event.code === "KeyO" || isOverrule(event)) releaseOverrule();
}

// While that key is down, a Mac does not tell of others that are released.
function forget() {
  stick.forget();
  scan.rest();
  overrule(false);
  send();
}

function onKey(event, down) {
  if (!down) release(event);
  else if (event.key === "Meta") forget();
  if (document.querySelector("dialog[open]") || event.ctrlKey || event.metaKey || event.altKey) return;
  const inField = isField(event.target);
  const onButton = event.target instanceof HTMLElement && event.target.matches("button, input, a, summary");
  if (down && !event.repeat && event.code !== "Tab" && scan.halt()) { event.preventDefault(); return; }
  if (!inField && scan.key(event, down)) { event.preventDefault(); return; }
  if (event.code === "Escape") { if (down) stopNow(); return; }
  if (event.code === "Space" && down && event.target !== by("overrule")) stopNow();
  if (inField) return;
  if (isOverrule(event)) { if (down && !event.repeat) pressOverrule(); event.preventDefault(); return; }
  if (event.code === "Space" && !onButton) { event.preventDefault(); return; }
  const isLetter = event.code.startsWith("Key");
  if (isLetter && !by("letters").checked) return;
  if (stick.key(event, down)) { event.preventDefault(); return; }
  if (event.code in LETTERS) { if (!down || !event.repeat) LETTERS[event.code](down); event.preventDefault(); return; }
  if (down && scene.key(event)) event.preventDefault();
}

addEventListener("keydown", (event) => onKey(event, true));
addEventListener("keyup", (event) => onKey(event, false));
// Who has set a slider with a pointer steers on with the arrows; who came to it with Tab goes on setting it.
addEventListener("pointerup", (event) => { if (event.target instanceof HTMLElement && event.target.matches("input[type=range]")) event.target.blur(); });

function steer() {
  const switches = Number(by("steer-by").value) || 0;
  by("scan-label").hidden = switches !== 1;
  stick.stop();
  scan.set(switches);
  document.body.dataset.switches = String(switches);
}

const FIRST = { "steer-by": by("steer-by").value, "scan-s": by("scan-s").value };

function setSeconds() {
  scan.seconds = Math.min(6, Math.max(0.4, Number(by("scan-s").value) || 1.4));
  scan.rest();
}

// Who drives with switches alone cannot choose them again after a reload.
function keepSteering() {
  for (const id of Object.keys(FIRST)) keep(id, by(id).value);
  keep("participant", study.view?.participant ?? "");
}

function steerAs(values) {
  for (const [id, first] of Object.entries(FIRST)) {
    by(id).value = values(id) ?? first;
    if (!by(id).value) by(id).value = first; // what was kept is none of the choices
  }
  steer();
  setSeconds();
}

// What one participant of a study chose, or somebody before it, is not another's: who is met anew begins with the stick.
function meet(participant) {
  if (kept("participant") !== String(participant)) steerAs(() => null);
}

by("steer-by").addEventListener("change", () => {
  steer();
  keepSteering();
  if (by("steer-by").value !== "stick") { by("steer-by").blur(); by("steering").focus(); }
});
by("scan-s").addEventListener("change", () => { setSeconds(); keepSteering(); });
steerAs(kept);

for (const id of ["new-place", "again", "user"]) by(id).addEventListener(id === "user" ? "change" : "click", () => hint.begin());
wireDialogs(stopNow);
wireDisplay();
