// A study: pages to read, questions, rests, and a strip above the drive. What comes next is the server's to say.

import { by, element } from "./shared.js";

const STOP_MS = 5000;
const OF_OTHERS = { welcome: "is reading the first page", read: "is reading about the next part", ask: "is answering questions", rest: "is resting", end: "has finished" };

export class Study {
  constructor(link, acts) {
    this.link = link;
    this.acts = acts; // say(text), stop(), switches(), seconds(), meet(participant)
    this.view = null;
    this.drives = false;
    this.shown = -1; // the step whose words are on the page
    this.opens_ms = 0;
    this.scan = new StudyScan(acts);
    for (const option of by("steer-by").options) by("study-steer").append(new Option(option.text, option.value));
    by("study").addEventListener("cancel", (event) => event.preventDefault());
    by("study-form").addEventListener("submit", (event) => { event.preventDefault(); this.press(); });
    by("study-steer").addEventListener("change", () => { by("steer-by").value = by("study-steer").value; by("steer-by").dispatchEvent(new Event("change")); this.scan.begin(); });
    by("study-questions").addEventListener("change", () => { if (this.asked) { this.asked = false; by("study-trouble").textContent = ""; } });
    by("study-stop").addEventListener("click", () => this.stop());
    addEventListener("keydown", (event) => { if (by("study").open && this.scan.key(event)) event.preventDefault(); });
    setInterval(() => this.tellButton(), 250);
  }

  setRole(drives) {
    this.drives = drives;
    this.update();
  }

  tell(view) {
    const isOther = view.participant !== this.view?.participant; // the server may have begun again, with another one
    const isNew = isOther || view.step !== this.view.step;
    this.view = view;
    if (isOther) { this.shown = -1; this.acts.meet(view.participant); }
    this.opens_ms = Date.now() + 1000 * view.wait_s;
    document.body.dataset.study = "true";
    by("assist").disabled = true;
    if (isNew) { this.asked = false; this.resetStop(); }
    this.update();
    if (isNew && this.drives) this.acts.say(view.kind === "drive" ? `${view.title}. Drive.` : view.title);
    if (view.kind === "drive" && Math.floor(view.left_s) === 60 && this.said !== view.step) { this.said = view.step; this.acts.say("One minute left."); }
  }

  notice(text) {
    if (by("study").open) by("study-trouble").textContent = text;
  }

  update() {
    const view = this.view;
    if (!view) return;
    const driving = view.kind === "drive";
    by("study-strip").hidden = this.drives && !driving;
    by("study-part").textContent = [view.where, view.title].filter(Boolean).join(": ");
    by("study-left").textContent = driving ? leftWords(view) : `participant ${view.participant} ${OF_OTHERS[view.kind]}`;
    by("study-stop").hidden = !driving || !this.drives;
    if (driving || !this.drives) { this.close(); return; }
    if (this.shown !== view.step || !by("study").open) this.open();
    by("study-trouble").textContent = view.trouble;
    this.tellButton();
  }

  open() {
    const view = this.view;
    this.acts.stop();
    if (this.shown !== view.step) this.render(view);
    if (!by("study").open) by("study").showModal();
    by("study").scrollTop = 0;
    by("study-title").focus();
    this.scan.begin();
  }

  close() {
    this.scan.end();
    if (!by("study").open) return;
    by("study").close();
    by("steering").focus({ preventScroll: true });
    scrollTo(0, 0);
  }

  render(view) {
    this.shown = view.step;
    by("study-where").textContent = view.where;
    by("study-title").textContent = view.title;
    by("study-number").textContent = `Participant ${view.participant}`;
    by("study-told").replaceChildren(...view.told.map((text) => element("p", text)));
    by("study-questions").replaceChildren(...view.questions.map(question));
    by("study-steer-label").hidden = !["welcome", "read"].includes(view.kind);
    by("study-steer").value = by("steer-by").value;
  }

  tellButton() {
    const view = this.view;
    if (!view || !by("study").open) return;
    const wait_s = Math.ceil((this.opens_ms - Date.now()) / 1000);
    const text = !view.ready ? "Preparing the street …" : wait_s > 0 ? `${view.button} (in ${wait_s} s)` : view.button;
    const go = by("study-go");
    go.hidden = !text;
    if (go.textContent !== text) go.textContent = text;
    go.setAttribute("aria-disabled", String(!view.ready || wait_s > 0));
  }

  press() {
    const view = this.view;
    if (by("study-go").getAttribute("aria-disabled") === "true") return;
    if (!this.link.there) { this.notice("The connection is lost. Press again when the page has reconnected."); return; }
    if (view.kind !== "ask") { this.link.say("goon", { step: view.step }); return; }
    const answers = view.questions.map((_, at) => { const on = document.querySelector(`input[name="question-${at}"]:checked`); return on ? Number(on.value) : -1; });
    const left = answers.filter((answer) => answer < 0).length;
    if (left && !this.asked) {
      this.asked = true;
      by("study-trouble").textContent = `${left === 1 ? "One question has" : `${left} questions have`} no answer yet. Press again to leave ${left === 1 ? "it" : "them"} out.`;
      const fields = [...document.querySelectorAll("#study-questions fieldset")];
      fields.forEach((field, at) => { field.dataset.left = String(answers[at] < 0); });
      fields[answers.indexOf(-1)].scrollIntoView({ block: "center" });
      if (!this.scan.on) fields[answers.indexOf(-1)].querySelector("input").focus({ preventScroll: true });
      return;
    }
    this.link.say("answerall", { step: view.step, answers });
  }

  stop() {
    if (this.sure) { this.link.say("goon", { step: this.view.step }); this.resetStop(); return; }
    this.sure = setTimeout(() => this.resetStop(), STOP_MS);
    by("study-stop").textContent = "Press again to end this part";
    this.acts.say("Press again to end this part.");
  }

  resetStop() {
    clearTimeout(this.sure);
    this.sure = 0;
    by("study-stop").textContent = "End this part early";
  }
}

function leftWords(view) {
  const left = Math.ceil(view.left_s ?? 0);
  const time = `${Math.floor(left / 60)}:${String(left % 60).padStart(2, "0")} left`;
  if (view.arrivals_left === null) return time;
  return `${view.arrivals_left} ${view.arrivals_left === 1 ? "arrival" : "arrivals"} left, ${time}`;
}

function question(asked, at) {
  const field = element("fieldset");
  field.addEventListener("change", () => { field.dataset.left = "false"; });
  field.append(element("legend", asked.asks));
  const isScale = asked.low !== "";
  const row = element("div", "", { className: isScale ? "scale" : "choices" });
  if (isScale) row.style.setProperty("--steps", asked.answers.length);
  asked.answers.forEach((text, index) => {
    const last = asked.answers.length - 1;
    const label = element("label");
    const box = element("input", "", { type: "radio", name: `question-${at}`, value: String(index) });
    label.append(box, element("span", text));
    const end = index === 0 ? asked.low : index === last ? asked.high : "";
    if (isScale && end) label.append(element("span", ` ${end}`, { className: "unseen" }));
    row.append(label);
  });
  field.append(row);
  if (isScale) {
    const ends = element("p", "", { className: "scale-ends" });
    ends.setAttribute("aria-hidden", "true");
    ends.append(element("span", asked.low), element("span", asked.high));
    field.append(ends);
  }
  return field;
}

// One or two switches on these pages: questions and the button in turn, within a question its answers, and out again.
// Three or four: 1 back, 3 on, 2 picks.
class StudyScan {
  constructor(acts) {
    this.acts = acts;
    this.on = false;
    this.timer = 0;
  }

  begin() {
    this.end();
    const count = this.acts.switches();
    this.on = count > 0;
    if (!this.on) return;
    this.enter(null);
    if (count === 1) this.timer = setInterval(() => this.move(1), 1000 * this.acts.seconds());
  }

  end() {
    clearInterval(this.timer);
    this.mark(null);
    this.on = false;
  }

  enter(inside) {
    this.inside = inside;
    const outer = () => [...document.querySelectorAll("#study-questions fieldset"), by("study-go")];
    this.items = inside ? [...inside.querySelectorAll("label"), inside.querySelector("legend")] : outer();
    this.at = 0;
    this.mark(this.items[0]);
  }

  mark(item) {
    for (const each of document.querySelectorAll("#study [data-at]")) delete each.dataset.at;
    if (!item) return;
    item.dataset.at = "here";
    item.scrollIntoView({ block: "nearest" });
  }

  move(by_) {
    this.at = (this.at + by_ + this.items.length) % this.items.length;
    this.mark(this.items[this.at]);
  }

  pick() {
    const item = this.items[this.at];
    if (item.matches("fieldset")) { this.enter(item); return; }
    if (item.matches("button")) { item.click(); return; }
    if (item.matches("label")) item.querySelector("input").click();
    const was = this.inside;
    this.enter(null);
    this.at = this.items.indexOf(was);
    if (item.matches("label")) this.at = (this.at + 1) % this.items.length;
    this.mark(this.items[this.at]);
  }

  key(event) {
    if (!this.on || event.code === "Tab" || event.metaKey || event.ctrlKey || event.altKey) return false;
    if (event.target instanceof HTMLElement && event.target.matches("select")) return false;
    if (event.repeat) return true;
    const count = this.acts.switches();
    if (count >= 3) {
      if (event.code === "Digit1") this.move(-1);
      else if (event.code === "Digit3") this.move(1);
      else if (event.code === "Digit2") this.pick();
      else return false;
    } else if (count === 2 && event.code !== "Enter") this.move(1);
    else this.pick();
    return true;
  }
}
