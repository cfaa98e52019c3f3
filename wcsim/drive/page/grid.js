// The joystick as a disc with the positions an agent can choose: the person's point, the chair's, the unsafe ones.

import { isPushed } from "./shared.js";
import { inGate, REST } from "./stick.js";

const SVG = "http://www.w3.org/2000/svg";
const SIZE = 100; // from the middle to the edge of the disc
const UNSAFE = "M-5-5 5 5M5-5-5 5";

function make(name, more, parent) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(more)) node.setAttribute(key, value);
  parent.append(node);
  return node;
}

export class Grid {
  constructor(home, stick, told = "Joystick. Push the disc with pointer or finger; the stick’s position is described in words below.") {
    this.stick = stick; // null where there is nothing to push
    const svg = make("svg", { viewBox: "-118 -132 236 264", role: "img", "aria-labelledby": "stick-title" }, home);
    make("title", { id: "stick-title" }, svg).textContent = told;
    make("circle", { class: "disc", r: 114 }, svg);
    make("circle", { class: "gate", r: SIZE }, svg);
    make("path", { class: "axis", d: "M0-114V114M-114 0H114" }, svg);
    for (const [x, y, word] of [[0, -120, "ahead"], [0, 128, "back"]]) {
      make("text", { x, y, class: "word" }, svg).textContent = word;
    }
    this.dots = make("g", {}, svg);
    this.reach = make("path", { class: "reach" }, svg);
    this.choice = make("path", { class: "choice", d: "M0-11 11 0 0 11-11 0Z" }, svg);
    this.you = make("circle", { class: "you", r: 8 }, svg);
    this.points = [];
    this.marks = [];
    if (stick) this.grip(svg);
    this.place(this.you, [0, 0]);
    this.place(this.choice, [0, 0]);
  }

  grip(svg) {
    const at = (event) => {
      const box = svg.getBoundingClientRect();
      const scale = 236 / box.width / SIZE;
      return inGate([(event.clientX - box.left - box.width / 2) * scale, -(event.clientY - box.top - box.height / 2) * scale]);
    };
    const { stick } = this;
    const end = (event) => { if (event.pointerId === stick.holder) { stick.holder = null; stick.pointer = REST; } };
    svg.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      stick.holder = event.pointerId;
      svg.setPointerCapture(event.pointerId);
      stick.pointer = at(event);
      event.preventDefault();
    });
    svg.addEventListener("pointermove", (event) => {
      if (!isPushed(event)) end(event);
      else if (event.pointerId === stick.holder) stick.pointer = at(event);
    });
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"]) svg.addEventListener(name, end);
    svg.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  setPoints(points) {
    this.points = points;
    this.dots.replaceChildren();
    this.marks = points.map(([x, y]) => make("path", { transform: `translate(${x * SIZE} ${-y * SIZE})` }, this.dots));
    this.show([]);
  }

  show(unsafe) {
    const bad = new Set(unsafe);
    this.marks.forEach((mark, index) => {
      const kind = bad.has(index) ? "cross" : "dot";
      if (mark.getAttribute("class") === kind) return;
      mark.setAttribute("class", kind);
      mark.setAttribute("d", kind === "cross" ? UNSAFE : "M-2.6 0a2.6 2.6 0 1 0 5.2 0a2.6 2.6 0 1 0-5.2 0");
    });
  }

  place(node, [x, y]) {
    node.setAttribute("transform", `translate(${(x * SIZE).toFixed(1)} ${(-y * SIZE).toFixed(1)})`);
  }

  move(stick, commanded) {
    for (const [node, at] of [[this.you, stick], [this.choice, commanded]]) {
      node.style.display = at ? "" : "none";
      if (at) this.place(node, at);
    }
    if (!stick || !commanded) { this.reach.setAttribute("d", ""); return; }
    const [a, b, c, d] = [...stick, ...commanded].map((part) => (part * SIZE).toFixed(1));
    this.reach.setAttribute("d", `M${a} ${-b}L${c} ${-d}`);
  }
}

export function words([x, y]) {
  const share = Math.round(Math.min(1, Math.hypot(x, y)) * 100);
  if (share < 8) return "at rest";
  const parts = [];
  if (Math.abs(y) > 0.2) parts.push(y > 0 ? "ahead" : "back");
  if (Math.abs(x) > 0.2) parts.push(x > 0 ? "right" : "left");
  return `${parts.join(" ") || "slightly"} ${share} %`;
}
