// What the page of a drive and the page of a film have alike: numbers, notices, dialogs, the switches of the display.

const NOTICE_MS = 6000;
let noticeTimer = 0;

export const by = (id) => document.getElementById(id);

export function element(name, text = "", more = {}) {
  const made = document.createElement(name);
  if (text) made.textContent = text;
  return Object.assign(made, more);
}

export function put(node, text) {
  if (node.textContent !== String(text)) node.textContent = String(text);
}

// A notice under the street; one that stays is there until the next.
export function note(kind, text, stays = false) {
  by("notice").dataset.kind = kind;
  by("notice").textContent = text;
  clearTimeout(noticeTimer);
  if (!stays) noticeTimer = setTimeout(() => { by("notice").textContent = ""; by("notice").dataset.kind = ""; }, NOTICE_MS);
}

// Words over the street, "" for none.
export function big(text) {
  by("big").hidden = !text;
  put(by("big"), text);
}

let busyTimer = 0, busySince = 0;

// What is waited for, over the street, "" for nothing, and for how long already.
export function waitFor(told, counts = true) {
  clearInterval(busyTimer);
  if (!told || !counts) busySince = 0;
  big(told);
  if (!told || !counts) return;
  busySince = busySince || performance.now(); // what is told of it later goes on from there
  busyTimer = setInterval(() => big(`${told} (${Math.round((performance.now() - busySince) / 1000)} s)`), 1000);
}

// A lamp; whether it has changed.
export function lamp(id, on, text) {
  const node = by(id);
  const word = node.querySelector("span");
  if (node.dataset.on === String(on) && word.textContent === text) return false;
  node.dataset.on = String(on);
  word.textContent = text;
  return true;
}

// How many, in words.
export const counted = (count, one, several = `${one}s`) => `${count} ${count === 1 ? one : several}`;

// The state of the connection: its words, and "good" or "bad".
export function line([text, kind]) {
  by("line").textContent = text;
  by("line").dataset.kind = kind;
}

// The list of numbers, of rows [name, label, function that makes the text].
export class Numbers {
  constructor(rows) {
    this.rows = rows;
    this.cells = {};
    for (const [name, label] of rows) {
      const pair = element("div");
      this.cells[name] = element("dd", "–", { id: `kpi-${name}` });
      pair.append(element("dt", label), this.cells[name]);
      by("kpis").append(pair);
    }
  }

  tell(...what) {
    for (const [name, , text] of this.rows) put(this.cells[name], what.length ? text(...what) : "–");
  }
}

// Buttons open their dialogs, after `first` was called.
export function wireDialogs(first = () => {}) {
  for (const name of ["keys", "display"]) by(`open-${name}`).addEventListener("click", () => { first(); by(name).showModal(); });
}

// What a browser keeps for this page; a private window keeps nothing.
export const kept = (name) => { try { return localStorage.getItem(`wcsim-${name}`); } catch { return null; } };
export const keep = (name, value) => { try { localStorage.setItem(`wcsim-${name}`, value); } catch { /* then it does not */ } };

// What counts while it is pushed, by a finger, a pen or a mouse's first button: `does(true, event)`, and `does(false)`
// however that ends. A button that is released while another one is held makes no "pointerup", and a menu takes it away.
export function wireHold(node, does) {
  let held = false;
  const end = () => { if (held) { held = false; does(false); } };
  node.addEventListener("pointerdown", (event) => { if (event.button === 0) { held = true; does(true, event); } });
  node.addEventListener("pointermove", (event) => { if (!isPushed(event)) end(); });
  for (const name of ["pointerup", "pointercancel", "lostpointercapture", "pointerleave"]) node.addEventListener(name, end);
  node.addEventListener("contextmenu", (event) => event.preventDefault());
}

export const isPushed = (event) => Boolean(event.buttons & 1);

// A tone, where the person asked for sounds.
let audio = null;
export function sound(hertz, seconds) {
  if (document.documentElement.dataset.sounds !== "true") return;
  audio = audio ?? new AudioContext();
  const tone = audio.createOscillator(), loud = audio.createGain();
  tone.frequency.value = hertz;
  loud.gain.setValueAtTime(0.25, audio.currentTime);
  loud.gain.exponentialRampToValueAtTime(0.001, audio.currentTime + seconds);
  tone.connect(loud).connect(audio.destination);
  tone.start();
  tone.stop(audio.currentTime + seconds);
}

// Contrast, larger text, single letters: kept in the browser; `after` is called at each change.
export function wireDisplay(after = () => {}) {
  const wantsContrast = matchMedia("(prefers-contrast: more)").matches;
  for (const [name, first, told] of [["contrast", wantsContrast, "High contrast"], ["larger", false, "Larger text"], ["letters", true, "Letter keys are shortcuts"], ["sounds", false, "Sounds for warning and crash"]]) {
    const label = element("label", "", { className: "tick" });
    const box = element("input", "", { id: name, type: "checkbox" });
    const row = element("p");
    label.append(box, ` ${told}`);
    row.append(label);
    by("switches").append(row);
    box.checked = kept(name) === null ? first : kept(name) === "true";
    const apply = () => { document.documentElement.dataset[name] = String(box.checked); keep(name, String(box.checked)); after(); };
    box.addEventListener("change", apply);
    apply();
  }
}
