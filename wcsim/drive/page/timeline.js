// The time line: marks as shapes in rows above a range input, so that they are told apart without colours.

import { counted, element } from "./shared.js";

const KINDS = { // one, several
  crash: ["crash", "crashes", "--bad", "✕"], drop: ["fall off a kerb", "falls off kerbs", "--bad", "▼"], intervention: ["intervention", "interventions", "--do", "▬"],
  warning: ["warning", "warnings", "--warned", "▲"], arrival: ["arrival", "arrivals", "--good", "●"], "gave-up": ["route given up", "routes given up", "--soft", "○"],
  help: ["call for help", "calls for help", "--you", "◆"], gap: ["new world", "new worlds", "--ink", "┃"],
};
const ROWS = { crash: 0, drop: 0, warning: 1, intervention: 2, arrival: 3, "gave-up": 3, help: 3, gap: -1 };
const ROW_PX = 11;
const THUMB_PX = 16; // half of it lies beyond the first and the last value

export class Timeline {
  constructor(canvas, range, legend, seek) {
    this.canvas = canvas;
    this.range = range;
    this.legend = legend;
    this.marks = [];
    this.shown = [];
    this.first = 0;
    this.last = 1;
    this.counts = "";
    range.addEventListener("input", () => seek(Number(range.value)));
    canvas.addEventListener("click", (event) => {
      const box = canvas.getBoundingClientRect();
      const share = (event.clientX - box.left - THUMB_PX / 2) / Math.max(1, box.width - THUMB_PX);
      seek(Math.round(this.first + Math.min(1, Math.max(0, share)) * (this.last - this.first)));
    });
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  setMarks(marks) {
    this.marks = marks;
  }

  choose(seat, all) {
    this.shown = this.marks.filter((mark) => all || mark[1] < 0 || mark[1] === seat);
    this.tell();
    this.draw();
  }

  setSpan(first, last) {
    const changed = first !== this.first || last !== this.last;
    this.first = first;
    this.last = Math.max(last, first + 1);
    if (changed) { this.range.min = String(first); this.range.max = String(this.last); this.draw(); }
  }

  next(kinds, from) {
    return this.shown.find((mark) => kinds.includes(mark[2]) && mark[0] > from);
  }

  before(kinds, from) {
    return this.shown.findLast((mark) => kinds.includes(mark[2]) && mark[0] < from);
  }

  tell() {
    const counts = {};
    for (const [, , kind] of this.shown) counts[kind] = (counts[kind] ?? 0) + 1;
    const said = JSON.stringify(counts);
    if (said === this.counts) return;
    this.counts = said;
    this.legend.replaceChildren(...Object.entries(KINDS).filter(([kind]) => counts[kind]).map(([kind, [one, several, colour, shape]]) => {
      const item = element("li");
      const sign = element("b", shape);
      sign.setAttribute("aria-hidden", "true");
      sign.style.color = `var(${colour})`;
      item.append(sign, counted(counts[kind], one, several));
      return item;
    }));
  }

  draw() {
    const { canvas } = this;
    const width = canvas.clientWidth;
    const scale = devicePixelRatio || 1;
    if (!width) return;
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(4 * ROW_PX * scale);
    const pen = canvas.getContext("2d");
    pen.scale(scale, scale);
    const style = getComputedStyle(document.documentElement);
    const drawn = new Set(); // one of a kind at a pixel is enough
    for (const [at, , kind] of this.shown) {
      if (at < this.first || !(kind in KINDS)) continue;
      const x = THUMB_PX / 2 + (at - this.first) / (this.last - this.first) * (width - THUMB_PX);
      const key = `${Math.round(x)} ${kind}`;
      if (drawn.has(key)) continue;
      drawn.add(key);
      pen.fillStyle = pen.strokeStyle = style.getPropertyValue(KINDS[kind][2]).trim() || "#000";
      shape(pen, kind, x, (Math.max(0, ROWS[kind]) + 0.5) * ROW_PX);
    }
  }
}

function shape(pen, kind, x, y) {
  pen.lineWidth = 2.2;
  pen.beginPath();
  if (kind === "crash") { pen.moveTo(x - 4, y - 4); pen.lineTo(x + 4, y + 4); pen.moveTo(x + 4, y - 4); pen.lineTo(x - 4, y + 4); pen.stroke(); }
  else if (kind === "drop") { pen.moveTo(x - 5, y - 4); pen.lineTo(x + 5, y - 4); pen.lineTo(x, y + 4); pen.fill(); }
  else if (kind === "warning") { pen.moveTo(x, y - 4); pen.lineTo(x + 4, y + 4); pen.lineTo(x - 4, y + 4); pen.fill(); }
  else if (kind === "intervention") { pen.rect(x - 1.5, y - 3.5, 3, 7); pen.fill(); }
  else if (kind === "arrival") { pen.arc(x, y, 4, 0, 7); pen.fill(); }
  else if (kind === "gave-up") { pen.lineWidth = 1.6; pen.arc(x, y, 3.4, 0, 7); pen.stroke(); }
  else if (kind === "help") { pen.moveTo(x, y - 5); pen.lineTo(x + 5, y); pen.lineTo(x, y + 5); pen.lineTo(x - 5, y); pen.fill(); }
  else { pen.lineWidth = 1; pen.setLineDash([3, 3]); pen.moveTo(x, 0); pen.lineTo(x, 4 * ROW_PX); pen.stroke(); pen.setLineDash([]); }
}
