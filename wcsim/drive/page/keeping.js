// The lamp that says whether this drive is kept, and where.

const lamp = document.getElementById("keeping");

// What is to be said aloud, "" for nothing.
export function tellKeeping(message) {
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
